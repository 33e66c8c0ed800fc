// The rotation step: a Riemannian trust region on the two orthonormal rows of a
// rotation.
//
// min 1/2 ||w - s Rbar S||_F^2 over Rbar Rbar^T = I_2 depends on w (2, q) and S (3, q)
// only through P = S S^T and D = w S^T. Rbar lies on the Stiefel manifold with the
// Euclidean metric; (r3; 0), (0; r3) and (-r2; r1) / sqrt(2) are an orthonormal basis
// of its tangent space, where r3 = r1 x r2, so that gradient, Hessian and steps are
// 3-vectors and 3x3 matrices in closed form.
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

// 1/2 ||w - s Rbar S||^2 - 1/2 ||w||^2 = 1/2 s^2 <Rbar P, Rbar> - s <D, Rbar> at a
// rotation, and s.
struct SquaredResidual {
    double value;
    double scale;
};

// Take R, proper, to a local minimum.
SquaredResidual rotation_step(const ShapeMoments& moments, Rotation& R);

}  // namespace shapefit
