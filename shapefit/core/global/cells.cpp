#include "cells.hpp"

namespace shapefit {
namespace {

constexpr double GOLDEN = 1.61803398874989484820;

// The even permutations of four places.
constexpr int EVEN[12][4] = {{0, 1, 2, 3}, {0, 2, 3, 1}, {0, 3, 1, 2}, {1, 0, 3, 2},
                             {1, 2, 0, 3}, {1, 3, 2, 0}, {2, 0, 1, 3}, {2, 1, 3, 0},
                             {2, 3, 0, 1}, {3, 0, 2, 1}, {3, 1, 0, 2}, {3, 2, 1, 0}};

// Vertices of one sign each: the units, (1, +-1, +-1, +-1) / 2 and the even permutations of
// (golden, +-1, +-1/golden, 0) / 2.
int place_vertices(double (*vertex)[4]) {
    int count = 0;
    for (int e = 0; e < 4; ++e, ++count)
        for (int f = 0; f < 4; ++f) vertex[count][f] = e == f;
    for (int signs = 0; signs < 8; ++signs, ++count) {
        vertex[count][0] = 0.5;
        for (int f = 0; f < 3; ++f) vertex[count][f + 1] = signs >> f & 1 ? -0.5 : 0.5;
    }
    for (const int* places : EVEN)
        for (int signs = 0; signs < 4; ++signs, ++count) {
            vertex[count][places[0]] = GOLDEN / 2;
            vertex[count][places[1]] = signs & 1 ? -0.5 : 0.5;
            vertex[count][places[2]] = (signs & 2 ? -0.5 : 0.5) / GOLDEN;
            vertex[count][places[3]] = 0;
        }
    return count;
}

}  // namespace

RootCells::RootCells() {
    place_vertices(vertex);
    double sign[ROOT_VERTICES][ROOT_VERTICES];  // of the inner product of neighbours, else 0
    for (int a = 0; a < ROOT_VERTICES; ++a)
        for (int b = 0; b < ROOT_VERTICES; ++b) {
            const double inner = inner4(vertex[a], vertex[b]);
            sign[a][b] = a != b && magnitude(inner) > 0.8 ? sign_of(inner) : 0;
        }
    // Four are a cell where, with the signs of the first one's hemisphere, all are neighbours.
    const auto join = [&](int a, int b, int c) {
        return sign[b][c] != 0 && sign[a][b] * sign[a][c] * sign[b][c] > 0;
    };
    int count = 0;
    for (int a = 0; a < ROOT_VERTICES; ++a)
        for (int b = a + 1; b < ROOT_VERTICES; ++b)
            for (int c = b + 1; sign[a][b] != 0 && c < ROOT_VERTICES; ++c)
                for (int d = c + 1; join(a, b, c) && d < ROOT_VERTICES; ++d)
                    if (join(a, b, d) && join(a, c, d)) cell[count++] = {{a, b, c, d}, 0};
}

}  // namespace shapefit
