// Cholesky factors of dense blocks: S = U^T U, U upper triangular, and V = U^-T.
#pragma once

namespace shapefit {

// From the upper triangle of S (n, n), rows `stride` apart, to U in its place and V, whose rows are
// filled with zeros to the stride; log det S, or nan where S is not positive definite. n is a
// multiple of PADDING.
double factorise_block(double* S, double* V, long n, long stride);

// C (n, n) of `stride`, its upper triangle and the tiles on the diagonal, = V^T V = S^-1.
void multiply_out(const double* V, double* C, long n, long stride);

// The lower triangle becomes that above it.
void mirror(double* C, long n, long stride);

}  // namespace shapefit
