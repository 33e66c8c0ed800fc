// Cholesky factors of dense blocks, S = U^T U with U upper triangular and V = U^-T, and
// the eigenvectors of small symmetric matrices.
#pragma once

#include "memory.hpp"

namespace shapefit {

// Overwrite S (n, n), its upper triangle with rows `stride` apart, by U, and set V =
// U^-T, its rows filled with zeros to the stride; returns log det S, or nan where S is
// not positive definite. n is a multiple of PADDING.
double cholesky_inverse(double* S, double* V, Index n, Index stride);

// C = V^T V = S^-1 (n, n), of which only the upper triangle and the tiles on the
// diagonal are right; rows of both are `stride` apart.
void multiply_out(const double* V, double* C, Index n, Index stride);

// C_ji = C_ij for j > i: copy the upper triangle of C (n, n) to the lower one.
void mirror(double* C, Index n, Index stride);

// Find the eigenvalues and eigenvectors of a symmetric A = V^T diag(values) V: the rows
// of V (m, m) are orthonormal, the values (m,) ascend. A (m, m), given in full, is
// overwritten.
//
// Cyclic Jacobi: for m up to 16, as here, no slower than a reduction to tridiagonal
// form, and the rows of V are orthogonal to rounding whatever the values are.
void symmetric_eigen(Matrix<double> A, Vector<double> values, Matrix<double> V);

}  // namespace shapefit
