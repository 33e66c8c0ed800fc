// From the transforms M_i = c_i Rbar_i of the convex program to rotations:
//
//     R = argmin ||R - A||_F over proper rotations, for A (3, 3),
//     Rbar = (A A^T)^(-1/2) A, the nearest two orthonormal rows, for A (2, 3).
#pragma once

#include "../convex/data.hpp"
#include "rotation.hpp"

namespace shapefit {

// The rotation nearest to A (3, 3), argmin ||R - A||_F over proper rotations.
//
// Of the unit quaternions q the one that maximises <A, R(q)> = q^T N q, with N linear
// in A: the eigenvector of the largest eigenvalue (Horn, 1987).
Rotation nearest_rotation(const double* A);

// Set R to the rotation whose first two rows are the polar factor (A A^T)^(-1/2) A of A
// (2, 3); one of the nearest pairs of orthonormal rows where A has rank one. False, and
// R is left as it is, where A is 0.
bool polar_rotation(const double* A, Rotation& R);

}  // namespace shapefit
