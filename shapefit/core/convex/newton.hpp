// One image in reduced coordinates, solved by Newton steps of two kinds.
//
//     min_M  f(w - sum_i M_i B_i) + lambda sum_i ||M_i||_2
//     max_y  <y, w> - delta/2 ||y||^2   over ||y B_i^T||_* <= lambda
//
// in the units ||w|| = 1 and max ||B_i|| = 1, and lambda = 1 where the loss has no
// quadratic, so that the unit of the dual is free there.
//
// From any start: the proximal-point method on the primal (equivalently the augmented
// Lagrangian method on the dual) repeats, with growing sigma,
//
//     y <- argmin phi(y) = delta/2 ||y||^2 - <y, w>
//         + 1/(2 sigma) sum_i ||prox_{sigma lambda}(M_i + sigma y B_i^T)||^2
//         + the part of the errors (errors.hpp)
//     M_i <- prox_{sigma lambda}(M_i + sigma y B_i^T)
//     E_j <- soft_{rho_j bound_j}(E_j + rho_j Y_j)
//
// phi is convex with a semismooth gradient and lives in 2 (p - 1) dimensions, so a
// Newton step costs one small factorisation and few steps suffice. Every iterate
// carries its duality gap.
//
// From a good start, for the squared loss: M and y solve the program and its dual
// together where
//
//     y = w - sum_i M_i B_i,    M_i = P_i := prox_{sigma lambda}(M_i + sigma y B_i^T).
//
// With W_i = D_i (I - D_i)^-1, D_i the derivative of the prox, a Newton step on both is
//
//     (I + sigma sum_i B_i^T W_i B_i) dy = w - y - sum_i (P_i + W_i (P_i - M_i)) B_i,
//     M_i <- P_i + W_i (sigma dy B_i^T + P_i - M_i),
//
// the system of the augmented dual with other weights. D_i has eigenvalues of 1, for a
// transform may grow freely along itself: their weights are capped (MAX_WEIGHT). Full
// steps, no line search: it converges from the solution of a neighbouring image or not
// at all.
#pragma once

#include "errors.hpp"
#include "row_system.hpp"

namespace shapefit {

// The convex program of one image in reduced coordinates, and when to stop.
struct ReducedProgram {
    ReducedAtoms& atoms;
    const double* w;  // (2, q)
    double lam;
    double delta;
    double tolerance;
    Index max_steps;

    Index q() const { return atoms.q(); }
    Index unknowns() const { return 2 * atoms.q(); }
    Index padded_atoms() const { return atoms.planes.padded_atoms; }
};

// The start, and where a solver leaves it: M (6, padded), y (2, q).
struct Iterate {
    double* M;
    double* y;
};

// Memory for images of up to q coordinates; everything is written before it is read.
struct NewtonWorkspace {
    ActiveBlocks active;
    ShiftedGram gram;
    RowSystem row_system;
    double *N, *change, *total;    // (6, padded), (6, padded), (padded,)
    double *gradient, *direction;  // (2 q)
    double *moved, *weighted;      // (6, padded), by active block
    double *start_M, *start_y;
    double* matrix;  // (2 q, 2 q), where there are further rows

    NewtonWorkspace(Workspace& workspace, Index padded_atoms, Index q,
                    Index further_rows);

    // Begin with other atoms, of q coordinates.
    void begin_atoms(Index q);
};

// Solve the program by the augmented Lagrangian from any iterate, which is overwritten,
// in at most max_steps - taken Newton steps; returns how many it took.
Index solve_lagrangian(const ReducedProgram& program, Iterate& iterate, NoErrors errors,
                       NewtonWorkspace& work, Index taken);
Index solve_lagrangian(const ReducedProgram& program, Iterate& iterate,
                       SparseErrors& errors, NewtonWorkspace& work, Index taken);

// How many Newton steps were taken, and whether the tolerance was reached.
struct PrimalDualEnd {
    Index steps;
    bool solved;
};

// Solve the program and its dual together from a good iterate, of which work.N holds y
// B_i^T; where the tolerance is not reached the iterate is left as it was.
PrimalDualEnd solve_primal_dual(const ReducedProgram& program, Iterate& iterate,
                                NewtonWorkspace& work);

// What a dual point y proves once it is scaled until it is feasible: s y has the value
// D = s <y, w> - delta/2 s^2 ||y||^2.
struct DualBound {
    double scale, value;

    // The bound by a y with ||y||^2 = yy and <y, w> = yw. `largest` is max_i ||y
    // B_i^T||_*, `share` the largest |y_j| / bound_j, 0 where there is no bound.
    DualBound(double lam, double delta, double largest, double share, double yy,
              double yw) {
        scale = smaller(lam / larger(largest, TINY), 1 / larger(share, TINY));
        if (delta > 0) scale = smaller(scale, yw / larger(yy, TINY));
        scale = larger(scale, 0);
        value = scale * yw - delta * 0.5 * scale * scale * yy;
    }

    // |P - D| / P.
    double relative_gap(double primal) const {
        return magnitude(primal - value) / larger(primal, TINY);
    }
};

}  // namespace shapefit
