// The square that touches Cauchy's loss from above at the residuals r, and its normal equations.
//
// At X <- X + omega x (R S) + tau and c <- c + d_c it is 1/2 |J (omega, tau, d_c) + r|^2, each row of
// J and r times the root of 1 / (1 + |r_j|^2 / s^2).
#pragma once

#include "projection.hpp"

namespace shapefit {

constexpr int POSE = 6;      // omega, tau
constexpr int RESIDUAL = 6;  // the column of r
constexpr int FIRST = 8;     // the column of the first coefficient; the one before is empty

// Columns: pose, r, an empty one, coefficients.
struct NormalEquations {
    Matrix<double> J;  // (2 q, 8 + k')
    Matrix<double> H;  // J^T J (8 + k', 8 + k'), its upper triangle by blocks of 8
    double *root_of_weight, *inverse_depth;  // (q,)
};

NormalEquations room_for_equations(Workspace& workspace, long filled, long p);

void linearise(const Shapes& shapes, const Sight& sight, const Unknowns& at,
               const Projection& seen, double softness, NormalEquations& equations);

}  // namespace shapefit
