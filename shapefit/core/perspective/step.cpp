#include "step.hpp"

#include "../base/vectors.hpp"

namespace shapefit {
namespace {

// L, L^-1 of what stands beside it, and of the right-hand side -J^T r.
void eliminate_pose(const Matrix<double>& H, double damping, StepSpace& space) {
    const long filled = space.C.size[1];
    for (int e = 0; e < POSE; ++e) {
        double* __restrict row = space.C[e].data;
        for (long i = 0; i < filled; ++i) row[i] = H[e][FIRST + i];
        space.pull[e] = -H[e][RESIDUAL];
        for (int f = 0; f < e; ++f) {
            double overlap = H[f][e];
            for (int b = 0; b < f; ++b) overlap -= space.L[e][b] * space.L[f][b];
            space.L[e][f] = overlap / space.L[f][f];
            space.pull[e] -= space.L[e][f] * space.pull[f];
            add_to(row, -space.L[e][f], space.C[f].data, filled);
        }
        double square_of = H[e][e] * (1 + damping);
        for (int f = 0; f < e; ++f) square_of -= square(space.L[e][f]);
        space.L[e][e] = root(larger(square_of, TINY));
        const double inverse = 1 / space.L[e][e];
        space.pull[e] *= inverse;
        for (long i = 0; i < filled; ++i) row[i] *= inverse;
    }
}

// Q and h of the program that is left over c + d_c.
void reduce_to_coefficients(const Shapes& shapes, const Matrix<double>& H, double damping,
                            const double* c, StepSpace& space) {
    const long filled = space.C.size[1];
    const double* C[POSE];
    for (int e = 0; e < POSE; ++e) C[e] = space.C[e].data;
    for (long i = 0; i < filled; ++i) {
        double* __restrict Q = space.Q[i].data;
        const double* row = H[FIRST + i].data + FIRST;
        const double c0 = C[0][i], c1 = C[1][i], c2 = C[2][i], c3 = C[3][i], c4 = C[4][i],
                     c5 = C[5][i];
        const long from = i / 8 * 8;  // blocks below the diagonal are not in H
        for (long j = from; j < filled; ++j)
            Q[j] = row[j] - c0 * C[0][j] - c1 * C[1][j] - c2 * C[2][j] - c3 * C[3][j] -
                   c4 * C[4][j] - c5 * C[5][j];
        Q[i] += damping * row[i] + shapes.ridge;
        for (long j = 0; j < from; ++j) Q[j] = space.Q[j][i];
    }
    for (long i = 0; i < filled; ++i) {
        double h = shapes.ridge * (shapes.prior[i] - c[i]) - H[RESIDUAL][FIRST + i];
        for (int e = 0; e < POSE; ++e) h -= C[e][i] * space.pull[e];
        space.h[i] = h + dot(space.Q[i].data, c, filled);
    }
}

// exp([omega]_x) R
void turn(const double* omega, const double* R, double* turned) {
    const double angle = root(square(omega[0]) + square(omega[1]) + square(omega[2]));
    const double sine = angle > 1e-8 ? sin(angle) / angle : 1;
    const double rest = angle > 1e-4 ? (1 - cos(angle)) / square(angle) : 0.5;
    const double cosine = 1 - rest * square(angle);
    for (int b = 0; b < 3; ++b) {
        const double x = R[b], y = R[3 + b], z = R[6 + b];
        const double along = rest * (omega[0] * x + omega[1] * y + omega[2] * z);
        turned[b] = cosine * x + sine * (omega[1] * z - omega[2] * y) + along * omega[0];
        turned[3 + b] = cosine * y + sine * (omega[2] * x - omega[0] * z) + along * omega[1];
        turned[6 + b] = cosine * z + sine * (omega[0] * y - omega[1] * x) + along * omega[2];
    }
}

}  // namespace

StepSpace::StepSpace(Workspace& workspace, long filled)
    : L{},
      pull{},
      C(workspace.matrix<double>(POSE, filled)),
      Q(workspace.matrix<double>(filled, filled)),
      h(workspace.vector<double>(filled)),
      x(workspace.vector<double>(filled)),
      program(workspace, filled) {}

void take_step(const Shapes& shapes, const NormalEquations& equations, double damping,
               const Unknowns& at, Unknowns& next, StepSpace& space) {
    const long filled = shapes.filled();
    eliminate_pose(equations.H, damping, space);
    reduce_to_coefficients(shapes, equations.H, damping, at.c, space);
    for (long i = 0; i < filled; ++i) next.c[i] = at.c[i];
    scaled_coefficients(space.program, {space.Q.data, {filled, filled}}, {space.h.data, {filled}},
                        {shapes.gauge.data, {filled}}, {next.c, {filled}});
    for (long i = 0; i < filled; ++i) space.x[i] = next.c[i] - at.c[i];
    double pose[POSE];
    for (int e = POSE - 1; e >= 0; --e) {
        double value = space.pull[e] - dot(space.C[e].data, space.x.data, filled);
        for (int f = e + 1; f < POSE; ++f) value -= space.L[f][e] * pose[f];
        pose[e] = value / space.L[e][e];
    }
    turn(pose, at.R, next.R);
    for (int a = 0; a < 3; ++a) next.t[a] = at.t[a] + pose[3 + a];
}

}  // namespace shapefit
