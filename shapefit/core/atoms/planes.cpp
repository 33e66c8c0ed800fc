#include "planes.hpp"

namespace shapefit {

Planes turn_atoms(Tensor<const double> atoms, Workspace& workspace) {
    const long k = atoms.size[0], p = atoms.size[2];
    Planes planes{nullptr, p, padded(k)};
    planes.data = workspace.zeros<double>(3 * p * planes.padded_atoms);
    for (long i = 0; i < k; ++i)
        for (int b = 0; b < 3; ++b)
            for (long j = 0; j < p; ++j) *planes.at(b, j, i) = atoms[i][b][j];
    return planes;
}

double reduce_atoms(const Planes& all, const double* omega, const Reduction& reduction,
                    Planes& reduced) {
    const long k = all.padded_atoms, q = reduction.coordinates();
    reduced.columns = q;
    reduced.padded_atoms = k;
    double largest = 0;
    for (long i = 0; i < k; i += WIDTH) {
        Doubles squares = {};
        for (int b = 0; b < 3; ++b) {
            Doubles along = {};
            for (long m = 0; m < reduction.seen; ++m) {
                const long j = reduction.visible[m];
                along += (omega[j] * reduction.h[m]) * load(all.at(b, j, i));
            }
            for (long m = 0; m < q; ++m) {
                const long j = reduction.visible[m];
                const Doubles x = omega[j] * load(all.at(b, j, i)) - reduction.h[m] * along;
                squares += x * x;
                store(reduced.at(b, m, i), x);
            }
        }
        for (int lane = 0; lane < WIDTH; ++lane) largest = larger(largest, squares[lane]);
    }
    largest = largest > 0 ? root(largest) : 1;
    const double scale = 1 / largest;
    for (long e = 0; e < 3 * q * k; e += WIDTH)
        store(reduced.data + e, scale * load(reduced.data + e));
    return largest;
}

namespace {

// `count` vectors of atoms from i.
template <int count>
[[gnu::always_inline]] inline void correlate_some(const Planes& B, const double* y0,
                                                  const double* y1, double* N, long i) {
    Doubles sums[6][count] = {};
    for (long j = 0; j < B.columns; ++j)
        for (int b = 0; b < 3; ++b)
            for (int v = 0; v < count; ++v) {
                const Doubles atoms = load(B.at(b, j, i + v * WIDTH));
                sums[b][v] += y0[j] * atoms;
                sums[3 + b][v] += y1[j] * atoms;
            }
    for (int e = 0; e < 6; ++e)
        for (int v = 0; v < count; ++v) store(N + e * B.padded_atoms + i + v * WIDTH, sums[e][v]);
}

}  // namespace

void correlate(const Planes& B, const double* y0, const double* y1, double* N) {
    constexpr int PAIR = WIDTH == 8 ? 2 : 1;  // 12 sums of 32 registers, 6 of 16
    long i = 0;
    for (; i + PAIR * WIDTH <= B.padded_atoms; i += PAIR * WIDTH)
        correlate_some<PAIR>(B, y0, y1, N, i);
    for (; i < B.padded_atoms; i += WIDTH) correlate_some<1>(B, y0, y1, N, i);
}

}  // namespace shapefit
