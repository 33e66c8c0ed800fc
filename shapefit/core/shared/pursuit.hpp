// Projected Matching Pursuit on one image after another (Ramakrishna, Kanade and Sheikh 2012).
//
//     min ||w - M sum_i y_i Q_i||^2 over M (2, 3) and ||y|| = length,
//
// in turn over y, globally, and over M, for the chosen shapes; then the atom with the largest
// |<w - M S, M B_i>| joins them, until the error is small enough.
#pragma once

#include "pursuit_data.hpp"

namespace shapefit {

void pursue(const PursuitData& data, Range range);

}  // namespace shapefit
