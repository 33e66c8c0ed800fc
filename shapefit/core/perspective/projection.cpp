#include "projection.hpp"

namespace shapefit {

void project(const Shapes& shapes, const Observations& observations, Position& here) {
    const Index p = shapes.p, filled = observations.filled, length = padded(3 * p);
    mix_rows(here.at.c, shapes.k, shapes.rows.data, length, length, here.S);
    for (int b = 0; b < 3; ++b)  // gathered where X will be
        for (Index j = 0; j < filled; ++j)
            here.X[b][j] = here.S[b * p + observations.index[j]];
    // Named pointers: an array of them hides from the compiler that they are apart.
    double* __restrict x = here.X[0];
    double* __restrict y = here.X[1];
    double* __restrict z = here.X[2];
    double* __restrict turned_x = here.turned[0];
    double* __restrict turned_y = here.turned[1];
    double* __restrict turned_z = here.turned[2];
    double* __restrict r_x = here.r[0];
    double* __restrict r_y = here.r[1];
    const double *w_x = observations.w[0], *w_y = observations.w[1];
    const double* omega = observations.omega;
    const double *R = here.at.R, *t = here.at.t;
    double behind = 0;
    for (Index j = 0; j < filled; ++j) {
        const double S_x = x[j], S_y = y[j], S_z = z[j];
        turned_x[j] = R[0] * S_x + R[1] * S_y + R[2] * S_z;
        turned_y[j] = R[3] * S_x + R[4] * S_y + R[5] * S_z;
        turned_z[j] = R[6] * S_x + R[7] * S_y + R[8] * S_z;
        x[j] = turned_x[j] + t[0];
        y[j] = turned_y[j] + t[1];
        z[j] = turned_z[j] + t[2];
        const double depth = observations.sign * z[j], inverse = 1 / depth;
        const double u = omega[j] * (observations.centre[0] +
                                     observations.focal[0] * x[j] * inverse - w_x[j]);
        const double v = omega[j] * (observations.centre[1] +
                                     observations.focal[1] * y[j] * inverse - w_y[j]);
        r_x[j] = depth > 0 ? u : INFINITE;
        r_y[j] = depth > 0 ? v : INFINITE;
        behind += depth > 0 ? 0.0 : 1.0;
    }
    here.in_front = behind == 0;
}

double evaluate(const Shapes& shapes, const Observations& observations,
                const Position& here, double softness) {
    if (!here.in_front) return INFINITE;
    const double square_of = square(softness), inverse = 1 / square_of;
    double loss = 0, distance = 0;
    for (Index j = 0; j < observations.filled; ++j)
        loss +=
            log_of_one_plus((square(here.r[0][j]) + square(here.r[1][j])) * inverse);
    for (Index i = 0; i < shapes.filled; ++i)
        distance += square(here.at.c[i] - shapes.prior[i]);
    return 0.5 * (square_of * loss + shapes.ridge * distance);
}

}  // namespace shapefit
