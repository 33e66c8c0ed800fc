// Eigenvalues and eigenvectors of a small symmetric matrix.
#pragma once

#include "views.hpp"

namespace shapefit {

// A = V^T diag(values) V: the rows of V (m, m) are orthonormal, the values (m,) ascend.
// A (m, m), given in full, is overwritten.
//
// Cyclic Jacobi: for m up to 16, as here, no slower than a reduction to tridiagonal form, and the
// rows of V are orthogonal to rounding whatever the values are.
void symmetric_eigen(Matrix<double> A, Vector<double> values, Matrix<double> V);

}  // namespace shapefit
