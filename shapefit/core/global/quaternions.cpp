#include "quaternions.hpp"

#include "../pose/rotations.hpp"

namespace shapefit {

void rotation_of(const double* q, double* R) {
    bilinear_rows(q, q, R);
    complete(R);
}

void quaternion_of(const double* R, double* q) {
    // 4 q_e^2 for each e; the largest of them is at least 1
    const double square[4] = {1 + R[0] + R[4] + R[8], 1 + R[0] - R[4] - R[8],
                              1 - R[0] + R[4] - R[8], 1 - R[0] - R[4] + R[8]};
    int most = 0;
    for (int e = 1; e < 4; ++e)
        if (square[e] > square[most]) most = e;
    const double products[4][4] = {
        {square[0], R[7] - R[5], R[2] - R[6], R[3] - R[1]},
        {R[7] - R[5], square[1], R[1] + R[3], R[2] + R[6]},
        {R[2] - R[6], R[1] + R[3], square[2], R[5] + R[7]},
        {R[3] - R[1], R[2] + R[6], R[5] + R[7], square[3]},
    };
    for (int e = 0; e < 4; ++e) q[e] = products[most][e];
    make_unit(q);
}

void turn_by(const double* turn, double* q) {
    const double angle = root(inner3(turn, turn));
    const double share = angle > 1e-8 ? sin(angle / 2) / angle : 0.5;
    const double w = cos(angle / 2), x = share * turn[0], y = share * turn[1], z = share * turn[2];
    const double old[4] = {q[0], q[1], q[2], q[3]};
    q[0] = w * old[0] - x * old[1] - y * old[2] - z * old[3];
    q[1] = w * old[1] + x * old[0] + y * old[3] - z * old[2];
    q[2] = w * old[2] - x * old[3] + y * old[0] + z * old[1];
    q[3] = w * old[3] + x * old[2] - y * old[1] + z * old[0];
    make_unit(q);
}

}  // namespace shapefit
