// Non-negative sparse coding: shapes as cheap non-negative mixtures of fixed atoms.
#pragma once

#include "data.hpp"

namespace shapefit {

// min_c 1/2 ||S - sum_i c_i B_i||_F^2 + beta sum_i c_i over c >= 0, for the shapes of the range.
//
// The next atom is the one that a coordinate descent step would move the shape by most with.
void code(const CodingData& data, Range range);

// The objective of given coefficients, for the shapes of the range.
void find_objectives(const MisfitData& data, Range range);

}  // namespace shapefit
