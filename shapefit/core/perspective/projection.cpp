#include "projection.hpp"

#include "../base/registry.hpp"
#include "../base/lanes.hpp"
#include "../base/logarithm.hpp"
#include "../base/vectors.hpp"

namespace shapefit {
namespace {

// S (3, p) = sum_i c_i B_i
void mix(const Shapes& shapes, const double* c, double* __restrict S) {
    const long k = shapes.atoms.size[0], length = 3 * shapes.atoms.size[2];
    for (long e = 0; e < length; ++e) S[e] = 0;
    const double* atoms = shapes.atoms.data;
    long i = 0;
    for (; i + 4 <= k; i += 4) {
        const double *a = atoms + i * length, *b = a + length, *d = b + length, *f = d + length;
        const double ca = c[i], cb = c[i + 1], cd = c[i + 2], cf = c[i + 3];
        for (long e = 0; e < length; ++e) S[e] += ca * a[e] + cb * b[e] + cd * d[e] + cf * f[e];
    }
    for (; i < k; ++i) add_to(S, c[i], atoms + i * length, length);
}

}  // namespace

Shapes arrange(Workspace& workspace, const PerspectiveData& data) {
    const long k = data.atoms.size[0], p = data.atoms.size[2], filled = padded(k);
    Shapes shapes{data.atoms, workspace.tensor<double>(p, 3, filled),
                  workspace.vector<double>(filled), workspace.vector<double>(filled), data.ridge};
    const double square = dot(data.prior.data, data.prior.data, k);
    for (long i = 0; i < k; ++i) {
        shapes.prior[i] = data.prior[i];
        shapes.gauge[i] = data.prior[i] / square;
        for (int b = 0; b < 3; ++b)
            for (long j = 0; j < p; ++j) shapes.by_landmark[j][b][i] = data.atoms[i][b][j];
    }
    return shapes;
}

Sight room_for_sight(Workspace& workspace, long p) {
    Sight sight{};
    for (double*& row : sight.w) row = workspace.zeros<double>(padded(p));
    sight.omega = workspace.zeros<double>(padded(p));
    sight.index = workspace.zeros<int64_t>(padded(p));
    return sight;
}

void look(const PerspectiveData& data, long image, Sight& sight) {
    const Vector<const double> omega = data.weights[image];
    sight.count = 0;
    for (long j = 0; j < omega.size[0]; ++j)
        if (omega[j] > 0) sight.index[sight.count++] = j;
    sight.filled = padded(sight.count);
    for (long e = 0; e < sight.filled; ++e) {
        const bool real = e < sight.count;
        if (!real) sight.index[e] = sight.index[0];
        sight.omega[e] = real ? omega[sight.index[e]] : 0;
        for (int a = 0; a < 2; ++a) sight.w[a][e] = data.landmarks[image][a][sight.index[e]];
    }
    for (int a = 0; a < 2; ++a) {
        sight.focal[a] = data.focal[image][a];
        sight.centre[a] = data.centre[image][a];
    }
    sight.sign = data.sign;
}

Projection room_for_projection(Workspace& workspace, long p) {
    Projection seen{};
    seen.S = workspace.zeros<double>(3 * p);
    for (double*& row : seen.turned) row = workspace.zeros<double>(padded(p));
    for (double*& row : seen.X) row = workspace.zeros<double>(padded(p));
    for (double*& row : seen.r) row = workspace.zeros<double>(padded(p));
    return seen;
}

void project(const Shapes& shapes, const Sight& sight, const Unknowns& at, Projection& seen) {
    const long p = shapes.atoms.size[2], filled = sight.filled;
    mix(shapes, at.c, seen.S);
    for (int b = 0; b < 3; ++b)  // gathered where X will be
        for (long j = 0; j < filled; ++j) seen.X[b][j] = seen.S[b * p + sight.index[j]];
    // Named pointers: an array of them hides from the compiler that they are apart.
    double *__restrict x = seen.X[0], *__restrict y = seen.X[1], *__restrict z = seen.X[2];
    double *__restrict turned_x = seen.turned[0], *__restrict turned_y = seen.turned[1];
    double *__restrict turned_z = seen.turned[2];
    double *__restrict r_x = seen.r[0], *__restrict r_y = seen.r[1];
    const double *w_x = sight.w[0], *w_y = sight.w[1], *omega = sight.omega, *R = at.R, *t = at.t;
    double behind = 0;
    for (long j = 0; j < filled; ++j) {
        const double S_x = x[j], S_y = y[j], S_z = z[j];
        turned_x[j] = R[0] * S_x + R[1] * S_y + R[2] * S_z;
        turned_y[j] = R[3] * S_x + R[4] * S_y + R[5] * S_z;
        turned_z[j] = R[6] * S_x + R[7] * S_y + R[8] * S_z;
        x[j] = turned_x[j] + t[0];
        y[j] = turned_y[j] + t[1];
        z[j] = turned_z[j] + t[2];
        const double depth = sight.sign * z[j], inverse = 1 / depth;
        const double u = omega[j] * (sight.centre[0] + sight.focal[0] * x[j] * inverse - w_x[j]);
        const double v = omega[j] * (sight.centre[1] + sight.focal[1] * y[j] * inverse - w_y[j]);
        r_x[j] = depth > 0 ? u : INFINITE;
        r_y[j] = depth > 0 ? v : INFINITE;
        behind += depth > 0 ? 0.0 : 1.0;
    }
    seen.in_front = behind == 0;
}

double evaluate(const Shapes& shapes, const Sight& sight, const Unknowns& at,
                const Projection& seen, double softness) {
    if (!seen.in_front) return INFINITE;
    const double square_of = square(softness), inverse = 1 / square_of;
    double loss = 0, distance = 0;
    for (long j = 0; j < sight.filled; ++j)
        loss += log_of_one_plus((square(seen.r[0][j]) + square(seen.r[1][j])) * inverse);
    for (long i = 0; i < shapes.filled(); ++i) distance += square(at.c[i] - shapes.prior[i]);
    return 0.5 * (square_of * loss + shapes.ridge * distance);
}

void project_alone(const ProjectionData& one) {
    const PerspectiveData& data = one.image;
    const long k = data.atoms.size[0], p = data.atoms.size[2];
    Workspace workspace;
    const Shapes shapes = arrange(workspace, data);
    Sight sight = room_for_sight(workspace, p);
    look(data, 0, sight);
    Projection seen = room_for_projection(workspace, p);
    Unknowns at{{}, {}, workspace.zeros<double>(shapes.filled())};
    for (int e = 0; e < 9; ++e) at.R[e] = data.rotation[0].data[e];
    for (int a = 0; a < 3; ++a) at.t[a] = data.translation[0][a];
    for (long i = 0; i < k; ++i) at.c[i] = data.coefficients[0][i];
    project(shapes, sight, at, seen);
    for (long j = 0; j < p; ++j) {
        for (int a = 0; a < 3; ++a) one.X[a][j] = seen.X[a][j];
        for (int a = 0; a < 2; ++a) one.r[a][j] = seen.r[a][j];
    }
}

const Exported<project_alone> project_perspective_exported{"project_perspective", PART};

}  // namespace shapefit
