// Cholesky factor of the Hessian of a sequence: each frame is tied to the two after it.
//
// A = U^T U with the blocks U_ff, N_f = U_f,f+1 and W_f = U_f,f+2 of frame f, and V_f = U_ff^-T:
//
//   U_ff^T U_ff = A_ff - N_(f-1)^T N_(f-1) - W_(f-2)^T W_(f-2)
//   N_f = V_f (A_f,f+1 - N_(f-1)^T W_(f-1)),     W_f = V_f A_f,f+2
//
// Frames are tied by the motion alone, coordinate by coordinate, so that A_f,f+1 and A_f,f+2 are
// diagonal and W_f is lower triangular. V and N are kept, W_f is V_f with its columns scaled.
#pragma once

#include "../base/memory.hpp"
#include "marginal.hpp"

namespace shapefit {

class Banded {
  public:
    Banded(Workspace& workspace, const SequenceData& data);

    // Factor the Hessian of the frames at a place, `damping` added to its diagonal, and take the
    // right sides R of `derive` along; false where it is not positive definite.
    bool factorise(const SequenceData& data, const Place& at, Bones bones, double damping);

    // Sums of products of the right sides, R^T A^-1 R (E, E).
    const double* products() const { return products_; }
    double log_det() const { return log_det_; }
    long columns() const { return E_; }

    // out (t, D) = A^-1 (R_0 + sum_b R_(1 + b) x_b)
    void solve(const SequenceData& data, const double* x, Matrix<double> out) const;

    // The covariance of each frame's points, the lengths held, to `data`: its block of A^-1, with the
    // mixture of the frame in the place of what stands for it in A, see marginal.hpp.
    void write_covariances(const SequenceData& data, const Place& at, Marginal& marginal) const;

  private:
    // Column scales of W_f = V_f diag(scales).
    void scales(const SequenceData& data, long f, long apart, double* out) const;

    long t_, D_, E_;
    double *V_, *N_, *F_;  // (t, D, D), (t, D, D), V (R - ...) (t, D, E)
    double *S_, *R_, *W_;  // of the frame at work; W of this frame and the two before
    double *products_, *mixed_, *work_;
    double log_det_ = 0;
};

}  // namespace shapefit
