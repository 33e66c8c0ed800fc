// 2 x 3 blocks in closed form, a vector of them at a time.
//
// For a block Q with rows x, y let A = |x|^2, C = |y|^2, D = x.y and r = |x x y| = s1 s2. Then
//     s1 + s2 = sqrt(A + C + 2 r),   s1 - s2 = sqrt((A - C)^2 + 4 D^2) / (s1 + s2),
// which stays exact where the two are equal; no singular value decomposition is needed. `Number` is
// a double or Doubles.
#pragma once

#include "../base/lanes.hpp"

namespace shapefit {

template <class Number>
struct Invariants {
    Number trace, product, spread;  // A + C, r, sqrt((A - C)^2 + 4 D^2)
};

template <class Number>
[[gnu::always_inline]] inline Invariants<Number> invariants(const Number (&q)[6]) {
    const Number c0 = q[1] * q[5] - q[2] * q[4], c1 = q[2] * q[3] - q[0] * q[5];
    const Number c2 = q[0] * q[4] - q[1] * q[3];
    const Number A = q[0] * q[0] + q[1] * q[1] + q[2] * q[2];
    const Number C = q[3] * q[3] + q[4] * q[4] + q[5] * q[5];
    const Number D = q[0] * q[3] + q[1] * q[4] + q[2] * q[5];
    return {A + C, root(c0 * c0 + c1 * c1 + c2 * c2), root((A - C) * (A - C) + 4.0 * D * D)};
}

// s1 + s2.
template <class Number>
[[gnu::always_inline]] inline Number nuclear_norm(const Invariants<Number>& block) {
    return root(block.trace + 2.0 * block.product);
}

// s1, exact where s2 is s1: the root of the largest eigenvalue of Q Q^T.
template <class Number>
[[gnu::always_inline]] inline Number spectral_norm(const Invariants<Number>& block) {
    return root(0.5 * (block.trace + block.spread));
}

// Blocks i, i + 1, ... of six rows of `stride` numbers.
struct BlockLanes {
    Doubles q[6];
};
[[gnu::always_inline]] inline BlockLanes load_blocks(const double* Q, long stride, long i) {
    BlockLanes blocks;
    for (int e = 0; e < 6; ++e) blocks.q[e] = load(Q + e * stride + i);
    return blocks;
}

// left -= M B for one block M (2, 3) and atom B (3, n), its rows `stride` apart; left (2, n).
[[gnu::always_inline]] inline void subtract_shape(const double* M, const double* B, long stride,
                                                  double* left, long n) {
    for (int a = 0; a < 2; ++a, left += n, M += 3)
        for (long j = 0; j < n; ++j)
            left[j] -= M[0] * B[j] + M[1] * B[stride + j] + M[2] * B[2 * stride + j];
}

// sum_i ||prox_t(M_i + sigma (N_i + step dN_i))||_F^2, and s1 + s2 of every argument in total (k,):
// atom i is active where total[i] > t. M, N, dN (6, k), k a multiple of PADDING.
double moreau(const double* M, const double* N, double step, const double* dN, double sigma,
              double t, double* total, long k);

// s1 + s2 of every M_i + sigma N_i, in total (k,).
void sum_singular_values(const double* M, const double* N, double sigma, double* total, long k);

// max_i ||N_i||_*.
double largest_nuclear_norm(const double* N, long k);

}  // namespace shapefit
