// Single steps of the convex solver, for the tests that judge them one at a time.
#pragma once

#include "data.hpp"

namespace shapefit {

// N (6, k) = Y B_i^T of Y (2, q) and atoms B (k, 3, q).
void correlate_part(Matrix<const double> Y, Tensor<const double> atoms, Matrix<double> N);
// max_i ||N_i||_* of N (6, k).
double nuclear_part(Matrix<const double> N);
// moreau of blocks.hpp for any k.
double moreau_part(const MoreauData& data);
// The derivative of prox_t at Q (6,): prox (6,), its rows F (6, 2 n + 1) over the atom B (3, n) with
// the right-hand side of `moved` (6,) in the last column, and W moved (6,). Returns their number.
long derivative_part(const DerivativeData& data);
// x of (C + F^T F) x = r + F^T f: C (n, n), or shift I where C is empty; F (rows, n), f (rows,).
void gram_part(const GramData& data);
// The curvature c (2, seen) of errors under weights omega (p,): its rows (2 seen, 2 q) and its
// matrix (2 q, 2 q).
void curvature_part(Vector<const double> omega, Matrix<const double> curvature,
                    Matrix<double> rows, Matrix<double> matrix);
// X (r, p) reduced to (r, q) and y (r, q) expanded to (r, p); returns the visible landmarks.
long reduce_part(Matrix<const double> X, Vector<const double> omega, Matrix<double> out);
long expand_part(Matrix<const double> y, Vector<const double> omega, Matrix<double> out);
// ||soft||^2 of the errors along a step, as SparseErrors::value takes it.
double soft_part(const SoftData& data);

}  // namespace shapefit
