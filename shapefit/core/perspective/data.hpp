// What the refinement under perspective reads and writes, as Python lays it out.
#pragma once

#include "../base/arguments.hpp"

namespace shapefit {

// min over R, t, c >= 0 of sum_j s^2/2 log(1 + |r_j|^2 / s^2) + ridge/2 |c - prior|^2, n images.
struct PerspectiveData {
    Arguments& from;
    Tensor<const double> landmarks = from("landmarks", "n 2 p");  // w
    Matrix<const double> weights = from("weights", "n p");  // Omega, 0 = hidden
    Tensor<const double> atoms = from("atoms", "k 3 p");  // B
    Vector<const double> prior = from("prior", "k");
    Matrix<const double> focal = from("focal", "n 2");
    Matrix<const double> centre = from("centre", "n 2");
    double sign = from("sign");  // of the depth: 1 where z points away from the camera, else -1
    double ridge = from("ridge");
    double softness = from("softness");  // s at the end
    long most_rounds = from("max_rounds");
    Tensor<double> rotation = from("rotation", "n 3 3");  // R, the start, overwritten
    Matrix<double> translation = from("translation", "n 3");  // t, likewise
    Matrix<double> coefficients = from("coefficients", "n k");  // c, likewise
    Vector<double> objective = from("objective", "n");
    Vector<int64_t> rounds = from("rounds", "n");
    Vector<int64_t> status = from("status", "n");
};

// One image, its points X and residuals r.
struct ProjectionData {
    Arguments& from;
    PerspectiveData image{from};
    Matrix<double> X = from("X", "3 p");
    Matrix<double> r = from("r", "2 p");
};

}  // namespace shapefit
