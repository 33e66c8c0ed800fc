// The rotation step: Newton's method in the turns of the camera frame, within a trust
// region.
//
// 1/2 ||w - s Rbar S||_F^2 over proper rotations depends on w (2, q) and S (3, q) only
// through P = S S^T and D = w S^T. With X = R P R^T and E = D R^T it is, but for 1/2
// ||w||^2,
//
//     f = s^2/2 (X_11 + X_22) - s (E_11 + E_22),
//
// and along R <- exp([turn]_x) R its gradient and Hessian are
//
//     g = s (E_23 - s X_23,  s X_13 - E_13,  E_12 - E_21)
//
//         | E_22 + s (X_33 - X_22)   s X_12 - (E_12 + E_21)/2   -(s X_13 + E_13)/2 |
//     H = s |          .            E_11 + s (X_33 - X_11)      -(s X_23 + E_23)/2 |
//         |          .                       .                      E_11 + E_22    |
//
// A free s is the best one at every R: it takes h h^T / (X_11 + X_22) off H, with h the
// derivative of g by s.
#pragma once

#include "../base/registry.hpp"
#include "rotation.hpp"

namespace shapefit {

// What the residual of a shape depends on. The scale s is 1, or the best one >= 0 where
// it is free.
struct ShapeMoments {
    const double* P;  // (3, 3)
    const double* D;  // (2, 3)
    bool free_scale;
};

// The squared residual f at a rotation, less the constant 1/2 ||w||^2, and the scale s.
struct SquaredResidual {
    double value;
    double scale;
};

// Move R, a proper rotation, to a local minimum of the squared residual f of a shape;
// returns f and the scale s there.
SquaredResidual rotation_step(const ShapeMoments& moments, Rotation& R);

}  // namespace shapefit
