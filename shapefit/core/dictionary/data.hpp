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

// 1/2 ||S - sum_i c_i B_i||^2 + beta sum_i c_i, for each shape.
struct MisfitData {
    Matrix<const double> shapes;        // S (n, d)
    Matrix<const double> atoms;         // B (k, d)
    Matrix<const double> coefficients;  // c (n, k)
    double beta;
    Vector<double> objectives;  // (n,)
};

// A += C^T C and D += C^T X: all that the best atoms for coefficients C depend on.
struct ProductsData {
    Matrix<const double> shapes;        // X (n, d)
    Matrix<const double> coefficients;  // C (n, k)
    Matrix<double> overlaps;            // A (k, k)
    Matrix<double> pulls;               // D (k, d)
};

// min_B 1/2 ||X - C B||_F^2 over rows ||B_i|| <= bound, some sweeps of it.
struct AtomUpdateData {
    Matrix<const double> overlaps;  // A = C^T C (k, k)
    Matrix<const double> pulls;     // D = C^T X (k, d)
    Matrix<double> atoms;           // B (k, d), overwritten
    double bound;
    long sweeps;
};

}  // namespace shapefit
