// Rotations as three rows of three numbers.
#pragma once

#include "../algebra/scalar.hpp"
#include "../algebra/views.hpp"

namespace shapefit::SHAPEFIT_LEVEL {

// r = u x v for vectors of three.
[[gnu::always_inline]] inline void cross(const double* u, const double* v, double* r) {
    r[0] = u[1] * v[2] - u[2] * v[1];
    r[1] = u[2] * v[0] - u[0] * v[2];
    r[2] = u[0] * v[1] - u[1] * v[0];
}

// The third row of R (3, 3) from the first two.
[[gnu::always_inline]] inline void complete(double* R) { cross(R, R + 3, R + 6); }

}  // namespace shapefit::SHAPEFIT_LEVEL
