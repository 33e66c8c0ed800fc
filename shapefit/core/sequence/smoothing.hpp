// The shapes of a whole sequence at once.
//
//   sum_f -log sum_k share_fk N(y_f; m_fk, P_fk^-1)  +  1/2 sum_(f,j) weight_fj ||w_fj - y_fj||^2
//     + 1/2 sum_(f,j) ||y_(f-1)j - 2 y_fj + y_(f+1)j||^2 / a_j^2
//     + 1/2 sum_(f, bones ij) (||y_fi - y_fj|| - l_ij)^2 / b_ij^2  +  1/2 (l - known)^T H (l - known)
//
// over frames and lengths l together, by the method of Levenberg and Marquardt.
#pragma once

#include "data.hpp"

namespace shapefit {

// A local minimum near the start, and the deviations there, the lengths held; no step raises the
// objective.
void smooth_sequence(const SequenceData& data);

}  // namespace shapefit
