// From the transforms M_i = c_i Rbar_i of the convex program to rotations:
//
//     R = argmin ||R - A||_F over proper rotations, for A (3, 3),
//     Rbar = (A A^T)^(-1/2) A, the nearest two orthonormal rows, for A (2, 3).
#pragma once

#include "../convex/data.hpp"
#include "rotation.hpp"

namespace shapefit {

// argmin ||R - A||_F over proper rotations; A (3, 3).
//
// Of the unit quaternions q the one that maximises <A, R(q)> = q^T N q, with N linear
// in A: the eigenvector of the largest eigenvalue (Horn, 1987).
Rotation nearest_rotation(const double* A);

// R with first rows (A A^T)^(-1/2) A, the polar factor of A (2, 3), completed.
// One of the nearest pairs of orthonormal rows where A has rank one; false, and R is
// left as it is, where A is 0.
bool polar_rotation(const double* A, Rotation& R);

}  // namespace shapefit
