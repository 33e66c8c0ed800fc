// What the kernels of dictionary read and write, as Python lays it out.
#pragma once

#include "../algebra/views.hpp"

namespace shapefit {

// min_c 1/2 c^T G c - h^T c over c >= 0, for each shape.
struct CodingData {
    Matrix<const double> gram;            // G = B B^T (k, k)
    Matrix<const double> pulls;           // h = S B^T - beta (n, k)
    Vector<const double> smallest_moves;  // (n,) by which a coefficient still has to move the shape
    Matrix<double> coefficients;          // c (n, k) >= 0, the start, overwritten
    Vector<bool> unsettled;               // (n,) where the moves did not become smaller
};

}  // namespace shapefit
