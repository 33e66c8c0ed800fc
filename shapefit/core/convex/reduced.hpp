// One image in reduced coordinates, and the room in which it is solved.
//
//     min_M f(w - sum_i M_i B_i) + lambda sum_i ||M_i||_2,    max_y <y, w> - delta/2 ||y||^2
//
// in the units ||w|| = 1 and max ||B_i|| = 1, and lambda = 1 where the loss has no quadratic, so that
// the unit of the dual is free there.
#pragma once

#include "../base/vectors.hpp"
#include "active.hpp"

namespace shapefit {

struct ReducedProgram {
    const Planes& planes;  // reduced B (3, q, padded)
    LaidAtoms& atoms;      // the same with the landmarks innermost
    const double* w;       // (2, q)
    double lam;
    double delta;
    double tolerance;
    long most_steps;

    long q() const { return planes.columns; }
    long unknowns() const { return 2 * planes.columns; }
    long padded_atoms() const { return planes.padded_atoms; }
};

// The start, and where a solver leaves it: M (6, padded), y (2, q).
struct Iterate {
    double* M;
    double* y;
};

// Room for up to q coordinates; everything is written before it is read.
struct Room {
    ActiveBlocks active;
    ShiftedGram gram;
    double *N, *change, *total;    // (6, padded), (6, padded), (padded,)
    double *gradient, *direction;  // (2 q)
    double *moved, *weighted;      // (6, padded), by active block
    double *start_M, *start_y;
    double* matrix;  // (2 q, 2 q), where there are further rows

    Room(Workspace& workspace, long padded_atoms, long q, long further_rows);
};

}  // namespace shapefit
