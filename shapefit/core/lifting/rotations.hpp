// Rotations as three rows of three numbers.
#pragma once

#include "../algebra/scalar.hpp"
#include "../algebra/views.hpp"

namespace shapefit::SHAPEFIT_LEVEL {

[[gnu::always_inline]] inline double inner3(const double* u, const double* v) {
    return u[0] * v[0] + u[1] * v[1] + u[2] * v[2];
}

// r = u x v for vectors of three.
[[gnu::always_inline]] inline void cross(const double* u, const double* v, double* r) {
    r[0] = u[1] * v[2] - u[2] * v[1];
    r[1] = u[2] * v[0] - u[0] * v[2];
    r[2] = u[0] * v[1] - u[1] * v[0];
}

// The third row of R (3, 3) from the first two.
[[gnu::always_inline]] inline void complete(double* R) { cross(R, R + 3, R + 6); }

// Orthonormalise the first two rows of R (3, 3) by Gram-Schmidt; their cross product is the third.
[[gnu::always_inline]] inline void orthonormalise(double* R) {
    const double xx = inner3(R, R), share = inner3(R + 3, R) / xx;
    for (int b = 0; b < 3; ++b) R[3 + b] -= share * R[b];
    const double x = 1 / root(xx), y = 1 / root(inner3(R + 3, R + 3));
    for (int b = 0; b < 3; ++b) {
        R[b] *= x;
        R[3 + b] *= y;
    }
    complete(R);
}

}  // namespace shapefit::SHAPEFIT_LEVEL
