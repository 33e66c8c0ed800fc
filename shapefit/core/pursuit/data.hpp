// What projected matching pursuit reads and writes, as Python lays it out.
#pragma once

#include <stdint.h>

#include "../algebra/views.hpp"

namespace shapefit {

// When a pursuit ends, and what it keeps.
struct PursuitRules {
    double length;     // root of the sum of squared limb lengths of the mixture
    double goal;       // squared error at which no more atoms join
    double change;     // of the squared error in a round, at which the inner loop ends
    long most_atoms;
    long most_rounds;  // of an inner loop
};

// n images over 1 + k shapes, the mean first.
struct PursuitData {
    Tensor<const double> landmarks;  // W (n, 2, p)
    Matrix<const double> weights;    // Omega (n, p)
    Tensor<const double> shapes;     // (1 + k, 3, p)
    Matrix<const double> limbs;      // limb vectors of the shapes (1 + k, l)
    PursuitRules rules;
    Matrix<double> coefficients;  // c (n, 1 + k), zeros
    Tensor<double> cameras;       // M (n, 2, 3)
    Vector<double> errors;        // ||w - M S||^2 (n,)
    Vector<int64_t> rounds;       // of all inner loops (n,)
    Vector<int64_t> status;       // (n,)
};

}  // namespace shapefit
