// What projected matching pursuit reads and writes, as Python lays it out.
#pragma once

#include "../base/arguments.hpp"

namespace shapefit {

// When a pursuit ends, and what it keeps.
struct PursuitRules {
    Arguments& from;
    double length = from("length");  // root of the sum of squared limb lengths of the mixture
    double goal = from("goal");  // squared error at which no more atoms join
    // of the squared error in a round, at which the inner loop ends
    double change = from("change");
    long most_atoms = from("most_atoms");
    long most_rounds = from("most_rounds");  // of an inner loop
};

// n images over 1 + k shapes, the mean first.
struct PursuitData {
    Arguments& from;
    Tensor<const double> landmarks = from("landmarks", "n 2 p");  // W
    Matrix<const double> weights = from("weights", "n p");  // Omega
    Tensor<const double> shapes = from("shapes", "1+k 3 p");
    Matrix<const double> limbs = from("limbs", "1+k l");  // limb vectors of the shapes
    PursuitRules rules{from};
    Matrix<double> coefficients = from("coefficients", "n 1+k");  // c, zeros
    Tensor<double> cameras = from("cameras", "n 2 3");  // M
    Vector<double> errors = from("errors", "n");  // ||w - M S||^2
    Vector<int64_t> rounds = from("rounds", "n");  // of all inner loops
    Vector<int64_t> status = from("status", "n");
};

}  // namespace shapefit
