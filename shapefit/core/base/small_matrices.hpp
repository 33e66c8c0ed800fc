// Cholesky factors of dense blocks, S = U^T U with U upper triangular and V = U^-T, and
// the eigenvectors of small symmetric matrices.
#pragma once

#include "memory.hpp"

namespace shapefit {

// From the upper triangle of S (n, n), rows `stride` apart, to U in its place and V,
// whose rows are filled with zeros to the stride; log det S, or nan where S is not
// positive definite. n is a multiple of PADDING.
double cholesky_inverse(double* S, double* V, Index n, Index stride);

// C (n, n) of `stride`, its upper triangle and the tiles on the diagonal, = V^T V =
// S^-1.
void multiply_out(const double* V, double* C, Index n, Index stride);

// The lower triangle becomes that above it.
void mirror(double* C, Index n, Index stride);

// A = V^T diag(values) V: the rows of V (m, m) are orthonormal, the values (m,) ascend.
// A (m, m), given in full, is overwritten.
//
// Cyclic Jacobi: for m up to 16, as here, no slower than a reduction to tridiagonal
// form, and the rows of V are orthogonal to rounding whatever the values are.
void symmetric_eigen(Matrix<double> A, Vector<double> values, Matrix<double> V);

}  // namespace shapefit
