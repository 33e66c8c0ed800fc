// Rotations R (3, 3) as values, and turns of the camera frame
//
//     R <- exp([omega]_x) R,    [omega]_x r = omega x r.
//
// Entries are doubles or vectors of doubles, one rotation a lane.
#pragma once

#include "../base/lanes.hpp"
#include "../base/memory.hpp"

namespace shapefit {

// u.v for vectors of three.
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

// C = the cofactors (3, 3) of a symmetric A (3, 3), A^-1 = C / det A; returns det A.
inline double find_cofactors(const double* A, double* C) {
    cross(A + 3, A + 6, C);
    cross(A + 6, A, C + 3);
    cross(A, A + 3, C + 6);
    return inner3(A, C);
}

// first = sin(a) / a and second = (1 - cos a) / a^2, the factors of Rodrigues' formula,
// of an angle a in radians whose square is given.
inline void find_factors(double square, double& first, double& second) {
    const double a = root(square), half = 0.5 * a;
    first = a > 1e-6 ? sin(a) / a : 1 - square / 6;
    const double sine = a > 1e-6 ? sin(half) / half : 1.0;
    second = 0.5 * sine * sine;
}
// The factors of Rodrigues' formula, lane by lane.
template <class Lanes>
inline void find_factors(Lanes square, Lanes& first, Lanes& second) {
    for (int lane = 0; lane < width<Lanes>; ++lane) {
        double one, two;
        find_factors(static_cast<double>(square[lane]), one, two);
        first[lane] = one;
        second[lane] = two;
    }
}

// A rotation R (3, 3), its entries row after row.
template <class Number>
struct RotationOf {
    Number entry[9];

    operator Number*() { return entry; }
    operator const Number*() const { return entry; }

    // A rotation with the first `rows` rows of R (3, 3), the others unset.
    static RotationOf from(const Number* R, int rows = 3) {
        RotationOf same;
        for (int e = 0; e < 3 * rows; ++e) same.entry[e] = R[e];
        return same;
    }
    // out (3, 3) = R.
    void write(Number* out) const {
        for (int e = 0; e < 9; ++e) out[e] = entry[e];
    }

    // Set the third row to the cross product of the first two.
    void complete() { cross(entry, entry + 3, entry + 6); }

    // Orthonormalise the first two rows by Gram-Schmidt; their cross product is the
    // third.
    void orthonormalise() {
        Number *u = entry, *v = entry + 3;
        const Number uu = inner3<Number>(u, u), share = inner3<Number>(v, u) / uu;
        for (int b = 0; b < 3; ++b) v[b] -= share * u[b];
        const Number x = 1 / root(uu), y = 1 / root(inner3<Number>(v, v));
        for (int b = 0; b < 3; ++b) {
            u[b] *= x;
            v[b] *= y;
        }
        complete();
    }

    // exp([omega]_x) R by Rodrigues' formula: each column r becomes r + sin(a)/a omega
    // x r + (1 - cos a)/a^2 omega x (omega x r), a = |omega| in radians.
    RotationOf turned(const Number* omega) const {
        Number first, second;
        find_factors(inner3(omega, omega), first, second);
        RotationOf turned;
        for (int c = 0; c < 3; ++c) {
            const Number r[3] = {entry[c], entry[3 + c], entry[6 + c]};
            Number once[3], twice[3];
            cross(omega, r, once);
            cross(omega, once, twice);
            for (int a = 0; a < 3; ++a)
                turned.entry[3 * a + c] = r[a] + first * once[a] + second * twice[a];
        }
        return turned;
    }
};
using Rotation = RotationOf<double>;

}  // namespace shapefit
