// 2 x 3 blocks in closed form, a vector of them at a time.
//
// For a block Q with rows x, y let A = |x|^2, C = |y|^2, D = x.y and r = |x x y| = s1
// s2. Then
//     s1 + s2 = sqrt(A + C + 2 r),   s1 - s2 = sqrt((A - C)^2 + 4 D^2) / (s1 + s2),
// which stays exact where the two are equal; no singular value decomposition is needed.
// `Number` is a double or Doubles.
#pragma once

#include "../atoms/reduced_atoms.hpp"
#include "gram.hpp"

namespace shapefit {

// s1^2 + s2^2, s1 s2 and s1^2 - s2^2 of a block.
template <class Number>
struct Invariants {
    Number trace, product, discriminant;  // A + C, r, sqrt((A - C)^2 + 4 D^2)
};

// s1^2 + s2^2, s1 s2 and s1^2 - s2^2 of the singular values of a block q (2, 3).
template <class Number>
[[gnu::always_inline]] inline Invariants<Number> invariants(const Number (&q)[6]) {
    const Number c0 = q[1] * q[5] - q[2] * q[4], c1 = q[2] * q[3] - q[0] * q[5];
    const Number c2 = q[0] * q[4] - q[1] * q[3];
    const Number A = q[0] * q[0] + q[1] * q[1] + q[2] * q[2];
    const Number C = q[3] * q[3] + q[4] * q[4] + q[5] * q[5];
    const Number D = q[0] * q[3] + q[1] * q[4] + q[2] * q[5];
    return {A + C, root(c0 * c0 + c1 * c1 + c2 * c2),
            root((A - C) * (A - C) + 4.0 * D * D)};
}

// s1 + s2 of a block.
template <class Number>
[[gnu::always_inline]] inline Number nuclear_norm(const Invariants<Number>& block) {
    return root(block.trace + 2.0 * block.product);
}

// s1 of a block, exact where s2 is s1: the root of the largest eigenvalue of Q Q^T.
template <class Number>
[[gnu::always_inline]] inline Number spectral_norm(const Invariants<Number>& block) {
    return root(0.5 * (block.trace + block.discriminant));
}

// WIDTH blocks, one a lane.
struct BlockLanes {
    Doubles q[6];
};
// Load blocks i, i + 1, ... of Q (6, stride).
[[gnu::always_inline]] inline BlockLanes load_blocks(const double* Q, Index stride,
                                                     Index i) {
    BlockLanes blocks;
    for (int e = 0; e < 6; ++e) blocks.q[e] = load(Q + e * stride + i);
    return blocks;
}

// left (2, n) -= M B for one block M (2, 3) and an atom B (3, n), its rows `stride`
// apart.
[[gnu::always_inline]] inline void subtract_shape(const double* M, const double* B,
                                                  Index stride, double* left, Index n) {
    for (int a = 0; a < 2; ++a, left += n, M += 3)
        for (Index j = 0; j < n; ++j)
            left[j] -= M[0] * B[j] + M[1] * B[stride + j] + M[2] * B[2 * stride + j];
}

// sum_i ||prox_t(Q_i)||_F^2 for Q_i = M_i + sigma (N_i + step dN_i); sets total (k,) to
// s1 + s2 of each Q_i: atom i is active where total[i] > t. M, N, dN (6, k), k a
// multiple of PADDING.
double moreau(const double* M, const double* N, double step, const double* dN,
              double sigma, double t, double* total, Index k);

// total (k,) = s1 + s2 of each M_i + sigma N_i, M and N (6, k).
void sum_singular_values(const double* M, const double* N, double sigma, double* total,
                         Index k);

// max_i ||N_i||_* of N (6, k).
double largest_nuclear_norm(const double* N, Index k);

// The blocks that the prox leaves alive, their frames, and the derivative of the prox
// in them.
//
// With Q = U diag(s) V^T and prox_t(Q) = U diag(f) V^T the derivative D acts on X = U^T
// dQ V: it scales the six unit directions
//
//     (X11 + X22) / sqrt 2   by 1
//     (X12 - X21) / sqrt 2   by (f1 + f2) / (s1 + s2)
//     X13                    by f1 / s1
//     X23                    by f2 / s2
//     (X11 - X22) / sqrt 2   by 0 where f1 = f2, else 1
//     (X12 + X21) / sqrt 2   by (f1 - f2) / (s1 - s2)
//
// so that a block whose singular values have become equal moves in four directions
// only.

// What a direction with the eigenvalue d of D weighs: d itself, as in the Newton system
// of the augmented dual, or d / (1 - d), at most MAX_WEIGHT, as in that of the
// optimality conditions.
enum class Weighing { derivative, resolvent };
constexpr double MAX_WEIGHT = 1e3;

// The active blocks of an image, block c of which is that of atom index[c].
struct ActiveBlocks {
    Index count = 0;
    double norms = 0;         // sum of the spectral norms of prox
    Index capacity;           // of every row below, a multiple of PADDING
    Index* index;             // atoms
    double *argument, *prox;  // (6, capacity)
    double *v, *w,
        *z;  // (3, capacity) right frame; u1 = (cosine, sine), u2 = (-sine, cosine)
    double *cosine, *sine;   // (capacity,)
    double *first, *second;  // (capacity,) singular values s1, s2 of the argument
    double* difference;      // (capacity,) s1 - s2
    double* norm;            // (capacity,) f1
    double* weight;          // (6, capacity) of the directions in the order above

    ActiveBlocks(Workspace& workspace, Index padded_atoms);

    // Find the active blocks of M + sigma N (6, k), those with s1 + s2 > t, of which
    // total (k,) holds the sums; their frames, singular values and prox.
    void find(const double* M, const double* N, double sigma, double t,
              const double* total, Index k);

    // Set the weights of the directions; after `find`, with the same t.
    void weigh(double t, Weighing weighing);

    // Find the directions T (2, 3) with sum_T (T B_i)^T (T B_i) = sigma B_i^T W B_i, W
    // the weights, and a right-hand side for each: 0, or, where `moved` (6, capacity)
    // is given, -sqrt(weight / sigma) <direction, moved>.
    void find_directions(double sigma, const double* moved);

    // The number of directions of block c: four where f1 = f2, else six.
    int directions(Index c) const { return weight[4 * capacity + c] == 0 ? 4 : 6; }
    // Entry e of a direction (2, 3) for all blocks (count,); e = 6: its right-hand
    // side.
    const double* entry(int direction, int e) const {
        return row_ + (7 * direction + e) * capacity;
    }

    // Write the rows T B_i of all directions, with their right-hand sides, to F of
    // `gram`; returns how many there are.
    Index write_rows(ReducedAtoms& atoms, ShiftedGram& gram) const;

    // out = W X for X and out (6, capacity): the component of X in each direction is
    // multiplied by its weight.
    void apply_weights(const double* X, double* out) const;

    // Subtract the rows of sum_i prox_i B_i (2, q) from y0 and y1.
    void subtract_fit(ReducedAtoms& atoms, double* y0, double* y1, Index q) const;

  private:
    void svd_and_prox(Index c, double t);
    Index rows_before(Index c) const;
    void write_rows_of(Index c, const double* B, Index atom_stride, Index first,
                       ShiftedGram& gram) const;

    double* row_;  // (7, 6, capacity): the six numbers of each direction, and the
                   // right-hand side
};

}  // namespace shapefit
