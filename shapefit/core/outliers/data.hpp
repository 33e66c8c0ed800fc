// What the search for outliers reads and writes, as Python lays it out.
#pragma once

#include <stdint.h>

#include "../algebra/views.hpp"

namespace shapefit {

// Landmarks of n images that agree with one pose of a known shape.
struct ConsensusData {
    Tensor<const double> landmarks;  // W (n, 2, p)
    Matrix<const double> squares;    // omega^2 (n, p), of mean 1 where not 0, which is hidden
    Matrix<const double> shape;      // S (3, p)
    Vector<const uint64_t> seeds;    // of the draws (n,)
    double threshold;                // of a residual, in units of the size of the shape
    long draws;
    long most_rounds;  // of fits of a pose to its inliers
    Matrix<bool> inliers;  // (n, p)
};

// One image beside the shape: w (2, p), omega^2 (p,) and S (3, p).
struct Scene {
    Matrix<const double> w;
    Vector<const double> squares;
    Matrix<const double> S;
};

}  // namespace shapefit
