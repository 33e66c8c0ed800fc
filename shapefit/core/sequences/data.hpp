// What the inference over sequences reads and writes, as Python lays it out.
#pragma once

#include <stdint.h>

#include "../algebra/views.hpp"

namespace shapefit {

// Precisions C^-1 of covariances C, and log det C, where `there` is set; else they stay as they are.
struct PrecisionData {
    Blocks<double> matrices;    // C, and then C^-1 (n, K, d, d)
    Matrix<const bool> there;   // (n, K)
    Matrix<const double> more;  // added to the diagonal of C (n, K)
    Matrix<double> log_det;     // (n, K)
};

// One sequence of t frames y_t (3p,) and its bones, of lengths l (e,); see smoothing.hpp.
struct SequenceData {
    Matrix<const double> landmarks;   // w (t, 2p), any number where hidden
    Matrix<const double> weight;      // of their squares (t, 2p), 0 where hidden
    Matrix<const double> log_share;   // of the modes (t, K), -inf where there are fewer
    Tensor<const double> means;       // m (t, K, 3p)
    Blocks<const double> precisions;  // P (t, K, 3p, 3p)
    Matrix<const double> log_det;     // of the covariances (t, K)
    Vector<const double> stiffness;   // 1/a^2 (p,)
    Matrix<const int64_t> bones;      // (e, 2)
    Vector<const double> rigidity;    // 1/b^2 (e,)
    Vector<const double> hold;        // (e,), of the squares of l - known
    Vector<const double> known;       // (e,)
    long most_rounds;
    double still;              // rounds end when the energy per frame falls by less
    Matrix<double> points;     // y (t, 3p): the start, and then the minimum
    Vector<double> lengths;    // l (e,), likewise
    Matrix<double> deviation;  // of the points (t, 3p), or (0, 0) where it is not wanted
    Matrix<double> correlation;  // likewise, of x with y, x with z and y with z of a landmark
    Tensor<double> covariance;   // of each frame (t, 3p, 3p), or (0, 0, 0) where it is not wanted
    Vector<double> end;        // energy at the minimum, log det of the last Hessian, rounds (3,)
};

}  // namespace shapefit
