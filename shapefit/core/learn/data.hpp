// What the kernels of dictionary read and write, as Python lays it out.
#pragma once

#include "../base/arguments.hpp"

namespace shapefit {

// min_c 1/2 c^T G c - h^T c over c >= 0, for each shape.
struct CodingData {
    Arguments& from;
    Matrix<const double> gram = from("gram", "k k");  // G = B B^T
    Matrix<const double> pulls = from("pulls", "n k");  // h = S B^T - beta
    // by which a coefficient still has to move the shape
    Vector<const double> smallest_moves = from("smallest_moves", "n");
    Matrix<double> coefficients = from("coefficients", "n k");  // c >= 0, the start, overwritten
    Vector<bool> unsettled = from("unsettled", "n");  // where the moves did not become smaller
};

// 1/2 ||S - sum_i c_i B_i||^2 + beta sum_i c_i, for each shape.
struct MisfitData {
    Arguments& from;
    Matrix<const double> shapes = from("shapes", "n d");  // S
    Matrix<const double> atoms = from("atoms", "k d");  // B
    Matrix<const double> coefficients = from("coefficients", "n k");  // c
    double beta = from("beta");
    Vector<double> objectives = from("objectives", "n");
};

// A += C^T C and D += C^T X: all that the best atoms for coefficients C depend on.
struct ProductsData {
    Arguments& from;
    Matrix<const double> shapes = from("shapes", "n d");  // X
    Matrix<const double> coefficients = from("coefficients", "n k");  // C
    Matrix<double> overlaps = from("overlaps", "k k");  // A
    Matrix<double> pulls = from("pulls", "k d");  // D
};

// min_B 1/2 ||X - C B||_F^2 over rows ||B_i|| <= bound, some sweeps of it.
struct AtomUpdateData {
    Arguments& from;
    Matrix<const double> overlaps = from("overlaps", "k k");  // A = C^T C
    Matrix<const double> pulls = from("pulls", "k d");  // D = C^T X
    Matrix<double> atoms = from("atoms", "k d");  // B, overwritten
    double bound = from("bound");
    long sweeps = from("sweeps");
};

}  // namespace shapefit
