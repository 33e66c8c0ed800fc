// One rotation shared by all transforms of an image, by a monotone fixed-point iteration.
#pragma once

#include "data.hpp"

namespace shapefit {

// argmax sum_i max(0, <M_i, Rbar>)^2 over orthonormal rows, for the images of the range.
void synchronise(const SynchronisationData& data, Range range);

// Iterate from R (3, 3) to a local maximum of sum_i max(0, <M_i, Rbar>)^2; returns it.
// blocks M (k, 2, 3). The sum is convex in Rbar, so that the maximiser of its linearisation, the
// polar factor of sum_i max(0, <M_i, Rbar>) M_i, never lowers it.
double climb(Tensor<const double> blocks, Matrix<double> R);

// R (3, 3) with first rows (A A^T)^(-1/2) A, the polar factor of A (2, 3), completed.
// One of the nearest pairs of orthonormal rows where A has rank one; false, and R is left as it
// is, where A is 0.
bool polar_rotation(Matrix<const double> A, Matrix<double> R);

}  // namespace shapefit
