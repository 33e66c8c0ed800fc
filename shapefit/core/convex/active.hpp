// The blocks that the prox leaves alive, their frames, and the derivative of the prox in them.
//
// With Q = U diag(s) V^T and prox_t(Q) = U diag(f) V^T the derivative D acts on X = U^T dQ V: it
// scales the six unit directions
//     (X11 + X22) / sqrt 2   by 1,                    (X12 - X21) / sqrt 2   by (f1 + f2) / (s1 + s2),
//     X13                    by f1 / s1,              X23                    by f2 / s2,
//     (X11 - X22) / sqrt 2   by 0 where f1 = f2, else 1,
//     (X12 + X21) / sqrt 2   by (f1 - f2) / (s1 - s2),
// so that a block whose singular values have become equal moves in four directions only.
#pragma once

#include "../atoms/planes.hpp"
#include "../base/shifted_gram.hpp"

namespace shapefit {

// What a direction with the eigenvalue d of D weighs: d itself, as in the Newton system of the
// augmented dual, or d / (1 - d), at most MOST_WEIGHT, as in that of the optimality conditions.
enum class Weighing { derivative, resolvent };
constexpr double MOST_WEIGHT = 1e3;

// Atoms with the landmarks innermost, copied from the planes when they are first used.
class LaidAtoms {
  public:
    LaidAtoms(Workspace& workspace, long atoms, long most_columns);
    void reset(const Planes& planes);  // forget all
    long stride() const { return stride_; }
    // B_i (3, stride), zero beyond the columns.
    const double* at(long i) { return laid_[i] ? data_ + i * size_ : lay(i); }

  private:
    const double* lay(long i);

    Planes planes_;
    long atoms_, stride_ = 0, size_;
    double* data_;
    bool* laid_;
};

struct ActiveBlocks {
    long count = 0;
    double norms = 0;         // sum of the spectral norms of prox
    long room;                // of every row below, a multiple of PADDING
    long* index;              // atoms
    double *argument, *prox;  // (6, room)
    double *v, *w, *z;        // (3, room) right frame; u1 = (cosine, sine), u2 = (-sine, cosine)
    double *cosine, *sine;    // (room,)
    double *first, *second;   // (room,) singular values s1, s2 of the argument
    double* difference;       // (room,) s1 - s2
    double* norm;             // (room,) f1
    double* weight;           // (6, room) of the directions in the order above

    ActiveBlocks(Workspace& workspace, long padded_atoms);

    // The blocks with s1 + s2 > t (total (k,) holds the sums) of M + sigma N (6, k), and their prox.
    void find(const double* M, const double* N, double sigma, double t, const double* total, long k);

    // Weights of the directions; after `find`, with the same t.
    void weigh(double t, Weighing weighing);

    // Write the rows f with sum f^T f = sigma B_i^T W B_i, W the weights; returns their number. In
    // the column of the right-hand side: 0, or, where `moved` (6, room) is given,
    // - sqrt(weight / sigma) <direction, moved>.
    long write_rows(double sigma, LaidAtoms& atoms, const double* moved, ShiftedGram& gram);

    // out = W X for X and out (6, room): the part of X in each direction, times its weight.
    void apply_weights(const double* X, double* out) const;

    // rows (2, q) -= sum_i prox_i B_i; rows y0, y1.
    void subtract_fit(LaidAtoms& atoms, double* y0, double* y1, long q) const;

  private:
    void decompose(long c, double t);
    void lay_directions(double sigma, const double* moved);

    double* row_;  // (7, 6, room): the six numbers of each direction, and the right-hand side
};

}  // namespace shapefit
