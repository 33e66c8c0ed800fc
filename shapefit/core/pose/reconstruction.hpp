// From the transforms of the convex program to the shape, and to the rotation that they agree on.
#pragma once

#include "../shared/data.hpp"

namespace shapefit {

// R_i completes M_i / c_i by the cross product of its rows, or is the rotation nearest to it.
void reconstruct(const ReconstructionData& data, Range range);

// argmin ||R - A||_F over proper rotations; A and R (3, 3).
//
// Of the unit quaternions q the one that maximises <A, R(q)> = q^T N q, with N linear in A: the
// eigenvector of the largest eigenvalue (Horn, 1987).
void nearest_rotation(Matrix<const double> A, Matrix<double> R);

}  // namespace shapefit
