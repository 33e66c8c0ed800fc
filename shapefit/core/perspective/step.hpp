// A damped step of Levenberg and Marquardt in the pose and the coefficients.
//
//     argmin 1/2 |J d + r|^2 + ridge/2 |c + d_c - prior|^2 + damping/2 sum_i (J^T J)_ii d_i^2
//
// over d_c >= -c with gauge^T d_c = 0. The pose is eliminated from the normal equations, and what is
// left is a small convex quadratic program in c.
#pragma once

#include "../atoms/scaled_coefficients.hpp"
#include "normal_equations.hpp"

namespace shapefit {

struct StepSpace {
    StepSpace(Workspace& workspace, long filled);

    double L[POSE][POSE];  // the pose's part of the damped matrix is L L^T
    double pull[POSE];     // L^-1 of the pose's part of the right-hand side
    Matrix<double> C;      // L^-1 of the rows between pose and coefficients (6, k')
    Matrix<double> Q;      // the quadratic program in c + d_c: 1/2 c^T Q c - h^T c (k', k')
    Vector<double> h, x;   // (k',)
    ScaledProgram program;
};

// The step from `at` to `next`.
void take_step(const Shapes& shapes, const NormalEquations& equations, double damping,
               const Unknowns& at, Unknowns& next, StepSpace& space);

}  // namespace shapefit
