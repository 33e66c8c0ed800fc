// Cholesky factor of the Hessian of a sequence: each frame is tied to the two after it.
//
// A = U^T U with the blocks U_ff, N_f = U_f,f+1 and W_f = U_f,f+2 of frame f, and V_f =
// U_ff^-T:
//
//   U_ff^T U_ff = A_ff - N_(f-1)^T N_(f-1) - W_(f-2)^T W_(f-2)
//   N_f = V_f (A_f,f+1 - N_(f-1)^T W_(f-1)),     W_f = V_f A_f,f+2
//
// Frames are tied by the motion alone, coordinate by coordinate, so that A_f,f+1 and
// A_f,f+2 are diagonal and W_f is lower triangular. V and N are kept, W_f is V_f with
// its columns scaled.
#pragma once

#include "objective.hpp"

namespace shapefit {

// The covariance of one frame's points, given the landmarks of the whole sequence.
//
// In the Hessian A of the sequence each frame has A_f = sum_k share_k P_k in the place
// of its mixture sum_k share_k N(m_k, P_k^-1): that bends as the mixture does at y, and
// knows nothing of modes away from there. So what all else says of the frame is taken
// apart from it, a Gaussian with the precision Lambda = Sigma_ff^-1 - A_f, whose
// gradient at y cancels that of the mixture, and the mixture put in its place (the
// marginal of expectation propagation, one step):
//
//   weight_k ~ share_k N(m_k; that Gaussian),   Q_k = P_k + Lambda,
//   delta_k = Q_k^-1 (P_k (m_k - y) + g),       g = sum_k share_k P_k (y - m_k) at y
//
//   covariance = sum_k weight_k (Q_k^-1 + (delta_k - delta)(delta_k - delta)^T)
//
// It is exact for a frame by itself. Which mode its neighbours stand in is taken as it
// is at the minimum.
class Marginal {
  public:
    Marginal(Workspace& workspace, const SequenceData& data)
        : D_(padded(data.points.size[1])),
          rest_(workspace.zeros<double>(D_ * D_)),
          whole_(workspace.zeros<double>(D_ * D_)),
          V_(workspace.zeros<double>(D_ * D_)),
          each_(workspace.zeros<double>(data.log_share.size[1] * D_ * D_)),
          weight_(workspace.zeros<double>(data.log_share.size[1])),
          delta_(workspace.zeros<double>(data.log_share.size[1] * D_)),
          away_(workspace.zeros<double>(D_)),
          linear_term_(workspace.zeros<double>(D_)),
          mean_(workspace.zeros<double>(D_)) {}

    // Deviations, correlations and covariance of frame f to `data`; Sigma (D, D) is its
    // block of A^-1.
    void write(const SequenceData& data, const Place& at, Index f, const double* Sigma);

  private:
    // The mixture's covariance in `whole_`; false where Sigma is as good.
    bool mix(const SequenceData& data, const Place& at, Index f, const double* Sigma);
    double weigh(const SequenceData& data, const Place& at, Index f, Index k);

    Index D_;
    double *rest_, *whole_, *V_;           // Lambda, the covariance, of one mode (D, D)
    double* each_;                         // Q_k^-1 (K, D, D)
    double* weight_;                       // (K,)
    double* delta_;                        // (K, D)
    double *away_, *linear_term_, *mean_;  // (D,)
};

class Banded {
  public:
    Banded(Workspace& workspace, const SequenceData& data)
        : t_(data.points.size[0]),
          D_(padded(data.points.size[1])),
          E_(padded(1 + data.lengths.size[0])),
          V_(workspace.zeros<double>(t_ * D_ * D_)),
          N_(workspace.zeros<double>(t_ * D_ * D_)),
          F_(workspace.zeros<double>(t_ * D_ * E_)),
          S_(workspace.zeros<double>(D_ * D_)),
          R_(workspace.zeros<double>(D_ * E_)),
          W_(workspace.zeros<double>(3 * D_ * D_)),
          products_(workspace.zeros<double>(E_ * E_)),
          work_(workspace.zeros<double>(8 * D_ * D_)) {}

    // Factor the Hessian of the frames at a place, `damping` added to its diagonal, and
    // take the right sides R of `derive` along; false where it is not positive
    // definite.
    bool factorise(const SequenceData& data, const Place& at, Bones bones,
                   double damping);

    // Sums of products of the right sides, R^T A^-1 R (E, E).
    const double* products() const { return products_; }
    Index columns() const { return E_; }

    // out (t, D) = A^-1 (R_0 + sum_b R_(1 + b) x_b)
    void solve(const SequenceData& data, const double* x, Matrix<double> out) const;

    // The covariance of each frame's points, the lengths held, to `data`: its block of
    // A^-1, with the mixture of the frame in the place of what stands for it in A; and
    // the energies of the frames.
    void write_covariances(const SequenceData& data, const Place& at,
                           Marginal& marginal) const;

  private:
    // Column scales of W_f = V_f diag(scales).
    void scales(const SequenceData& data, Index f, Index lag, double* out) const;

    Index t_, D_, E_;
    double *V_, *N_, *F_;  // (t, D, D), (t, D, D), V (R - ...) (t, D, E)
    double *S_, *R_, *W_;  // of the frame at work; W of this frame and the two before
    double *products_, *work_;
};

}  // namespace shapefit
