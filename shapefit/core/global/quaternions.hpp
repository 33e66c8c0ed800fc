// Quaternions (w, x, y, z) and the two rows of a rotation that the camera sees.
#pragma once

#include "../base/scalar.hpp"
#include "../base/views.hpp"

namespace shapefit {

inline double inner4(const double* p, const double* q) {
    return p[0] * q[0] + p[1] * q[1] + p[2] * q[2] + p[3] * q[3];
}

inline void make_unit(double* q) {
    const double length = 1 / root(inner4(q, q));
    for (int e = 0; e < 4; ++e) q[e] *= length;
}

// out (6,) = Q(p, q), symmetric and bilinear, rows one after another: Q(q, q) = |q|^2 Rbar.
inline void bilinear_rows(const double* p, const double* q, double* out) {
    const double ww = p[0] * q[0], xx = p[1] * q[1], yy = p[2] * q[2], zz = p[3] * q[3];
    const double wx = p[0] * q[1] + p[1] * q[0], wy = p[0] * q[2] + p[2] * q[0];
    const double wz = p[0] * q[3] + p[3] * q[0], xy = p[1] * q[2] + p[2] * q[1];
    const double xz = p[1] * q[3] + p[3] * q[1], yz = p[2] * q[3] + p[3] * q[2];
    out[0] = ww + xx - yy - zz;
    out[1] = xy - wz;
    out[2] = xz + wy;
    out[3] = xy + wz;
    out[4] = ww - xx + yy - zz;
    out[5] = yz - wx;
}

// R (3, 3) of a unit quaternion.
void rotation_of(const double* q, double* R);

// The unit quaternion of R (3, 3), one of the two.
void quaternion_of(const double* R, double* q);

// q <- exp(turn) q: the rotation goes on by |turn| radians about the axis `turn` of the camera frame.
void turn_by(const double* turn, double* q);

}  // namespace shapefit
