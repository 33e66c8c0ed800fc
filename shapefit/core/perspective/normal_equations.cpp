#include "normal_equations.hpp"

#include "../base/lanes.hpp"

namespace shapefit {
namespace {

constexpr int TALL = 8;  // rows of a block of H: as many sums as hide the latency of one

// What all rows need, landmarks side by side.
void weigh(const Sight& sight, const Projection& seen, double softness,
           NormalEquations& equations) {
    double* __restrict root_of_weight = equations.root_of_weight;
    double* __restrict inverse_depth = equations.inverse_depth;
    const double inverse = 1 / square(softness);
    for (long j = 0; j < sight.filled; ++j) {
        const double size = square(seen.r[0][j]) + square(seen.r[1][j]);
        root_of_weight[j] = 1 / root(1 + size * inverse);
        inverse_depth[j] = 1 / (sight.sign * seen.X[2][j]);
    }
}

// Row a of landmark j.
void fill_row(const Shapes& shapes, const Sight& sight, const Unknowns& at, const Projection& seen,
              const NormalEquations& equations, long j, int a, double* __restrict row) {
    const double root_of_weight = equations.root_of_weight[j];
    const double inverse_depth = equations.inverse_depth[j];
    const double along = root_of_weight * sight.omega[j] * sight.focal[a] * inverse_depth;
    double v[3] = {};  // the derivative in X_j
    v[a] = along;
    v[2] = -along * seen.X[a][j] * (sight.sign * inverse_depth);
    const double x = seen.turned[0][j], y = seen.turned[1][j], z = seen.turned[2][j];
    row[0] = y * v[2] - z * v[1];
    row[1] = z * v[0] - x * v[2];
    row[2] = x * v[1] - y * v[0];
    for (int b = 0; b < 3; ++b) row[3 + b] = v[b];
    row[RESIDUAL] = root_of_weight * seen.r[a][j];
    double u[3];
    for (int b = 0; b < 3; ++b) u[b] = v[0] * at.R[b] + v[1] * at.R[3 + b] + v[2] * at.R[6 + b];
    const long filled = shapes.filled();
    const double* atoms = shapes.by_landmark[sight.index[j]].data;
    for (long i = 0; i < filled; ++i)
        row[FIRST + i] = u[0] * atoms[i] + u[1] * atoms[filled + i] + u[2] * atoms[2 * filled + i];
}

// H = J^T J in blocks of 8 x WIDTH that are summed in registers; `rows` rows of J.
void sum_squares(const NormalEquations& equations, long rows) {
    const long width = equations.H.size[0];
    const double* J = equations.J.data;
    for (long i = 0; i < width; i += TALL)
        for (long j = i; j < width; j += WIDTH) {
            Lanes total[TALL] = {};
            for (long row = 0; row < rows; ++row) {
                const double* left = J + row * width + i;
                const Lanes right = load(J + row * width + j);
                for (int e = 0; e < TALL; ++e) total[e] += left[e] * right;
            }
            for (int e = 0; e < TALL; ++e) store(equations.H[i + e].data + j, total[e]);
        }
}

}  // namespace

NormalEquations room_for_equations(Workspace& workspace, long filled, long p) {
    const long width = FIRST + filled, q = padded(p);
    return {workspace.matrix<double>(2 * p, width), workspace.matrix<double>(width, width),
            workspace.zeros<double>(q), workspace.zeros<double>(q)};
}

void linearise(const Shapes& shapes, const Sight& sight, const Unknowns& at,
               const Projection& seen, double softness, NormalEquations& equations) {
    weigh(sight, seen, softness, equations);
    for (long j = 0; j < sight.count; ++j)
        for (int a = 0; a < 2; ++a)
            fill_row(shapes, sight, at, seen, equations, j, a, equations.J[2 * j + a].data);
    sum_squares(equations, 2 * sight.count);
}

}  // namespace shapefit
