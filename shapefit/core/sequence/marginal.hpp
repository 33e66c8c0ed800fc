// The covariance of one frame of a sequence: of the product of its mixture of
// Gaussians, of precisions P_k and means m_k, and the Gaussian of precision Lambda that
// stands for all other frames,
//
//     covariance = sum_k weight_k (Q_k^-1 + (delta_k - delta)(delta_k - delta)^T),
//     Q_k = P_k + Lambda,    delta = sum_k weight_k delta_k.
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
//   weight_k ~ share_k N(m_k; that Gaussian),
//   delta_k = Q_k^-1 (P_k (m_k - y) + g),       g = sum_k share_k P_k (y - m_k) at y
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

    // Write the deviations, correlations and covariance of frame f to `data`; Sigma (D,
    // D) is its block of A^-1.
    void write(const SequenceData& data, const Place& at, Index f, const double* Sigma);

  private:
    // Set `whole_` to the covariance of frame f with its whole mixture; false where the
    // mixture has one mode, or rounding hides the others: then it is Sigma.
    bool mix(const SequenceData& data, const Place& at, Index f, const double* Sigma);
    // Set Q_k^-1 and delta_k of mode k of frame f; returns the log of its weight, but
    // for a constant, or -infinity where rounding has left Q_k without a factor.
    double weigh(const SequenceData& data, const Place& at, Index f, Index k);

    Index D_;
    double *rest_, *whole_, *V_;           // Lambda, the covariance, of one mode (D, D)
    double* each_;                         // Q_k^-1 (K, D, D)
    double* weight_;                       // (K,)
    double* delta_;                        // (K, D)
    double *away_, *linear_term_, *mean_;  // (D,)
};

}  // namespace shapefit
