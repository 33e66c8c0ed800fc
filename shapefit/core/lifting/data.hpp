// What the kernels of lifting read and write, as Python lays it out.
#pragma once

#include <stdint.h>

#include "../algebra/views.hpp"

namespace shapefit {

// How the search for a local minimum ended, as in lifting/estimate.py.
struct LocalStatus {
    enum : int64_t { CONVERGED = 0, ITERATION_LIMIT = 1, DEGENERATE = 2, FAILED = 3 };
};

// 1/2 ||w - s Rbar S||^2 - 1/2 ||w||^2 at a rotation, and s.
struct Misfit {
    double value;
    double scale;
};

// A step within a trust region: whether it ends at the edge, and the fall that the model promises.
struct TrustedStep {
    bool at_edge;
    double fall;
};

// Where an alternation ended.
struct AlternationEnd {
    long steps;
    bool converged;
};

// argmin sum_i ||M_i - c_i Rbar||_F^2 over c >= 0 and Rbar Rbar^T = I, for each image.
struct SynchronisationData {
    Blocks<const double> transforms;  // M (n, k, 2, 3)
    Tensor<double> rotation;          // R (n, 3, 3), left alone where all M_i are 0
};

// argmin 1/2 ||w - s Rbar S||_F^2 over rotations and s >= 0, for each image.
struct PoseData {
    Tensor<const double> shape_moments;       // P = S S^T (n, 3, 3)
    Tensor<const double> landmarks_by_shape;  // D = w S^T (n, 2, 3)
    Blocks<const double> starts;              // (n, v, 3, 3)
    Tensor<double> rotation;                  // (n, 3, 3)
    Vector<double> size;                      // s (n,)
};

// min 1/2 ||Omega o (W - Rbar sum_i c_i B_i - T 1^T)||_F^2 + lambda ||c||_1, Rbar Rbar^T = I.
struct AlternationData {
    Tensor<const double> landmarks;  // W (n, 2, p)
    Matrix<const double> weights;    // Omega (n, p)
    Tensor<const double> atoms;      // B (k, 3, p)
    Vector<const double> lam;        // (n,)
    Blocks<const double> starts;     // (n, s, 3, 3)
    bool is_signed;                  // c of either sign, or c >= 0
    double tolerance;                // relative fall of the objective in a round at which it ends
    long most_rounds;
    Matrix<double> coefficients;  // (n, k), of the best start; so are rotation and status
    Tensor<double> rotation;      // (n, 3, 3)
    Vector<int64_t> rounds;       // (n,), of all starts together
    Vector<int64_t> status;       // (n,), a LocalStatus
};

}  // namespace shapefit
