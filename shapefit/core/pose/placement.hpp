// Shapes from coefficients, and shapes placed on landmarks.
#pragma once

#include "../shared/data.hpp"

namespace shapefit {

// S = R sum_i c_i B_i.
void combine(const CombinationData& data, Range range);

// T = the mean of W - S with the weights squared; what is left there.
void place(const PlacementData& data, Range range);

}  // namespace shapefit
