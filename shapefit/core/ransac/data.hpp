// What the search for outliers reads and writes, as Python lays it out.
#pragma once

#include "../base/arguments.hpp"

namespace shapefit {

// Landmarks of n images that agree with one pose of a known shape.
struct ConsensusData {
    Arguments& from;
    Tensor<const double> landmarks = from("landmarks", "n 2 p");  // W
    // omega^2, of mean 1 where not 0, which is hidden
    Matrix<const double> squares = from("squares", "n p");
    Matrix<const double> shape = from("shape", "3 p");  // S
    Vector<const uint64_t> seeds = from("seeds", "n");  // of the draws
    double threshold = from("threshold");  // of a residual, in units of the size of the shape
    long draws = from("draws");
    long most_rounds = from("max_rounds");  // of fits of a pose to its inliers
    Matrix<bool> inliers = from("inliers", "n p");
};

}  // namespace shapefit
