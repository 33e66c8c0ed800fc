// What the refinement under perspective reads and writes, as Python lays it out.
#pragma once

#include <stdint.h>

#include "../algebra/views.hpp"

namespace shapefit {

// min over R, t, c >= 0 of sum_j s^2/2 log(1 + |r_j|^2 / s^2) + ridge/2 |c - prior|^2, n images.
struct PerspectiveData {
    Tensor<const double> landmarks;  // w (n, 2, p)
    Matrix<const double> weights;    // Omega (n, p), 0 = hidden
    Tensor<const double> atoms;      // B (k, 3, p)
    Vector<const double> prior;      // (k,)
    Matrix<const double> focal;      // (n, 2)
    Matrix<const double> centre;     // (n, 2)
    double sign;                     // of the depth: 1 where z points away from the camera, else -1
    double ridge;
    double softness;  // s at the end
    long most_rounds;
    Tensor<double> rotation;       // R (n, 3, 3), the start, overwritten
    Matrix<double> translation;    // t (n, 3), likewise
    Matrix<double> coefficients;   // c (n, k), likewise
    Vector<double> objective;      // (n,)
    Vector<int64_t> rounds;        // (n,)
    Vector<int64_t> status;        // (n,)
};

}  // namespace shapefit
