// Rotations as three rows of three numbers.
#pragma once

#include "../base/lanes.hpp"
#include "../base/memory.hpp"

namespace shapefit {

template <class Number>
inline Number inner3(const Number* u, const Number* v) {
    return u[0] * v[0] + u[1] * v[1] + u[2] * v[2];
}

// r = u x v for vectors of three.
template <class Number>
inline void cross(const Number* u, const Number* v, Number* r) {
    r[0] = u[1] * v[2] - u[2] * v[1];
    r[1] = u[2] * v[0] - u[0] * v[2];
    r[2] = u[0] * v[1] - u[1] * v[0];
}

// The cofactors C (3, 3) of a symmetric A (3, 3), A^-1 = C / det A; returns det A.
inline double find_cofactors(const double* A, double* C) {
    cross(A + 3, A + 6, C);
    cross(A + 6, A, C + 3);
    cross(A, A + 3, C + 6);
    return inner3(A, C);
}

// The third row of R (3, 3) from the first two.
template <class Number>
inline void complete(Number* R) {
    cross(R, R + 3, R + 6);
}

// Orthonormalise the first two rows of R (3, 3) by Gram-Schmidt; their cross product is the third.
template <class Number>
inline void orthonormalise(Number* R) {
    const Number xx = inner3<Number>(R, R), share = inner3<Number>(R + 3, R) / xx;
    for (int b = 0; b < 3; ++b) R[3 + b] -= share * R[b];
    const Number x = 1 / root(xx), y = 1 / root(inner3<Number>(R + 3, R + 3));
    for (int b = 0; b < 3; ++b) {
        R[b] *= x;
        R[3 + b] *= y;
    }
    complete(R);
}

}  // namespace shapefit
