// 2 x 3 blocks in closed form, many at a time.
//
// For a block Q with rows x, y let A = |x|^2, C = |y|^2, D = x.y and r = |x x y| = s1 s2. Then
//     s1 + s2 = sqrt(A + C + 2 r),   s1 - s2 = sqrt((A - C)^2 + 4 D^2) / (s1 + s2),
// which stays exact where the two are equal; no singular value decomposition is needed.
#pragma once

#include "../algebra/scalar.hpp"

namespace shapefit::SHAPEFIT_LEVEL {

struct Invariants {
    double trace, product, spread;  // A + C, r, sqrt((A - C)^2 + 4 D^2)
};

[[gnu::always_inline]] inline Invariants invariants(double x0, double x1, double x2, double y0,
                                                    double y1, double y2) {
    const double c0 = x1 * y2 - x2 * y1, c1 = x2 * y0 - x0 * y2, c2 = x0 * y1 - x1 * y0;
    const double A = x0 * x0 + x1 * x1 + x2 * x2, C = y0 * y0 + y1 * y1 + y2 * y2;
    const double D = x0 * y0 + x1 * y1 + x2 * y2;
    return {A + C, root(c0 * c0 + c1 * c1 + c2 * c2), root((A - C) * (A - C) + 4 * D * D)};
}

// Of block i of six rows of `stride` numbers.
[[gnu::always_inline]] inline Invariants invariants(const double* Q, long stride, long i) {
    return invariants(Q[i], Q[stride + i], Q[2 * stride + i], Q[3 * stride + i], Q[4 * stride + i],
                      Q[5 * stride + i]);
}

// s1, the spectral norm.
[[gnu::always_inline]] inline double spectral_norm(const Invariants& block) {
    const double plus = root(block.trace + 2 * block.product);
    return 0.5 * (plus + block.spread / larger(plus, TINY));
}

// ||prox_t(Q)||_F^2, with s1 + s2 = plus and s1 - s2 = minus.
[[gnu::always_inline]] inline double squared_prox(double plus, double minus, double t) {
    const double excess = larger(plus - t, 0), first = 0.5 * (plus + minus) - t;
    const double second = 0.5 * (plus - minus);
    return minus <= t ? 0.5 * excess * excess : first * first + second * second;
}

// sum_i ||prox_t(M_i + sigma (N_i + step dN_i))||_F^2, and s1 + s2 of every argument in total (k,):
// atom i is active where total[i] > t. M, N, dN (6, k).
double moreau(const double* M, const double* N, double step, const double* dN, double sigma,
              double t, double* total, long k);

}  // namespace shapefit::SHAPEFIT_LEVEL
