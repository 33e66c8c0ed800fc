// Newton steps on the optimality conditions of the squared loss, from a good start.
//
// M and y solve the program and its dual together where
//     y = w - sum_i M_i B_i,    M_i = P_i := prox_{sigma lambda}(M_i + sigma y B_i^T).
// With W_i = D_i (I - D_i)^-1, D_i the derivative of the prox, a Newton step on both is
//     (I + sigma sum_i B_i^T W_i B_i) dy = w - y - sum_i (P_i + W_i (P_i - M_i)) B_i,
//     M_i <- P_i + W_i (sigma dy B_i^T + P_i - M_i),
// the system of the augmented dual with other weights. D_i has eigenvalues of 1, for a transform may
// grow freely along itself: their weights are capped (MOST_WEIGHT). Full steps, no line search: it
// converges from the solution of a neighbouring image or not at all.
#pragma once

#include "reduced.hpp"

namespace shapefit {

struct PrimalDualEnd {
    long steps;
    bool solved;
};

// Takes the iterate, of which room.N holds the correlation, to the tolerance; where it does not get
// there the iterate is left as it was.
PrimalDualEnd solve_primal_dual(const ReducedProgram& program, Iterate& iterate, Room& room);

}  // namespace shapefit
