// A strictly convex quadratic program in coefficients whose scale is fixed.
#pragma once

#include "../base/active_set.hpp"

namespace shapefit {

// Room for programs of k coefficients, one after another.
struct ScaledProgram {
    ScaledProgram(Workspace& workspace, long k);

    ActiveSet set;
    double *score, *weight;
};

// Overwrite x with argmin 1/2 x^T Q x - h^T x over x >= 0, a^T x = 1.
// Q (k, k) positive definite, both triangles given; h (k,); a (k,) >= 0; x (k,) feasible.
void scaled_coefficients(ScaledProgram& program, Matrix<const double> Q, Vector<const double> h,
                         Vector<const double> a, Vector<double> x);

// The same for one program, in room of its own.
void solve_scaled(Matrix<const double> Q, Vector<const double> h, Vector<const double> a,
                  Vector<double> x);

}  // namespace shapefit
