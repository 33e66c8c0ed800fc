// Semismooth Newton steps on the augmented dual, from any start.
//
// The proximal-point method on the primal (equivalently the augmented Lagrangian method on the dual)
// repeats, with growing sigma,
//
//     y <- argmin phi(y) = delta/2 ||y||^2 - <y, w>
//                          + 1/(2 sigma) sum_i ||prox_{sigma lambda}(M_i + sigma y B_i^T)||^2
//                          + the part of the errors (errors.hpp)
//     M_i <- prox_{sigma lambda}(M_i + sigma y B_i^T)
//     E_j <- soft_{rho_j bound_j}(E_j + rho_j Y_j)
//
// phi is convex with a semismooth gradient and lives in 2 (p - 1) dimensions, so a Newton step costs
// one small factorisation and few steps suffice. Every iterate carries its duality gap.
#pragma once

#include "errors.hpp"

namespace shapefit {

// Solve from the iterate, which is overwritten, within most_steps - taken; returns Newton steps.
long solve_lagrangian(const ReducedProgram& program, Iterate& iterate, NoErrors errors, Room& room,
                      long taken);
long solve_lagrangian(const ReducedProgram& program, Iterate& iterate, SparseErrors& errors,
                      Room& room, long taken);

}  // namespace shapefit
