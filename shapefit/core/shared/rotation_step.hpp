// The rotation step: a Riemannian trust region on the two orthonormal rows of a rotation.
//
// min 1/2 ||w - s Rbar S||_F^2 over Rbar Rbar^T = I_2 depends on w (2, q) and S (3, q) only through
// P = S S^T and D = w S^T. Rbar lies on the Stiefel manifold with the Euclidean metric; (r3; 0),
// (0; r3) and (-r2; r1) / sqrt(2) are an orthonormal basis of its tangent space, where r3 = r1 x r2,
// so that gradient, Hessian and steps are 3-vectors and 3x3 matrices in closed form.
#pragma once

#include "data.hpp"

namespace shapefit {

// What the misfit of a shape depends on. The scale s is 1, or the best one >= 0 where it is free.
struct ShapeMoments {
    const double* P;  // (3, 3)
    const double* D;  // (2, 3)
    bool free_scale;
};

// Take R (3, 3), proper, to a local minimum.
Misfit rotation_step(const ShapeMoments& moments, double* R);

// 1/2 s^2 <Rbar P, Rbar> - s <D, Rbar>.
double value_at(const ShapeMoments& moments, const double* R);

// The misfit at R, its Riemannian gradient g (3,) and Hessian H (3, 3).
//
// The Hessian is Proj(s^2 U P - Lambda U) with Lambda = sym(Rbar G^T) and G = s (s Rbar P - D);
// a free s takes its share off, h h^T / tr(Rbar P Rbar^T) with h the derivative of the gradient
// by s (Schur complement).
Misfit model_at(const ShapeMoments& moments, const double* R, double* g, double* H);

// Steihaug's conjugate gradients for min g x + 1/2 x H x over |x| <= radius; step x (3,).
TrustedStep truncated_cg(const double* g, const double* H, double radius, double* step);

// Orthonormalise Rbar + step, step (3,) in the basis of the tangent space, and complete it.
void retract(const double* R, const double* step, double* out);

// The same with arrays, for tests.
Misfit take_rotation_step(Matrix<const double> P, Matrix<const double> D, bool free_scale,
                          Matrix<double> R);
double rotation_value(Matrix<const double> P, Matrix<const double> D, bool free_scale,
                      Matrix<const double> R);
Misfit rotation_model(Matrix<const double> P, Matrix<const double> D, bool free_scale,
                      Matrix<const double> R, Vector<double> g, Matrix<double> H);
TrustedStep trusted_step(Vector<const double> g, Matrix<const double> H, double radius,
                         Vector<double> step);
void retract_rotation(Matrix<const double> R, Vector<const double> step, Matrix<double> out);
void orthonormalise_rows(Matrix<double> R);

}  // namespace shapefit
