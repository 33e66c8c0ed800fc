#include "sphere.hpp"

#include "../base/registry.hpp"
#include "../base/scalar.hpp"
#include "../base/symmetric_eigen.hpp"

namespace shapefit {
namespace {

constexpr double ROUNDING = 64 * 0x1p-52;
constexpr int MOST_STEPS = 100;

// Multiplier and y where y is given by its coordinates z = V y.
struct Root {
    double shift;   // of the multiplier from the pole
    double square;  // ||z||^2
};

// The largest root, right of the pole or on it; z is written. `shift` starts left of the root.
Root find_root(const double* above, const double* t, double radius, double shift, double* z,
               long m) {
    double square = 0;
    for (int step = 0; step < MOST_STEPS; ++step) {
        double slope = 0;
        square = 0;
        for (long i = 0; i < m; ++i) {
            if (t[i] == 0) continue;
            z[i] = t[i] / (above[i] + shift);
            square += z[i] * z[i];
            slope += z[i] * z[i] / (above[i] + shift);
        }
        const double excess = root(square) / radius - 1;
        if (excess <= ROUNDING) break;
        shift += excess * square / slope;
    }
    return {shift, square};
}

}  // namespace

SphereSpace sphere_space(Workspace& workspace, long m) {
    return {workspace.zeros<double>(m * m), workspace.zeros<double>(m * m),
            workspace.zeros<double>(m),     workspace.zeros<double>(m),
            workspace.zeros<double>(m),     workspace.zeros<double>(m)};
}

double minimise_on_sphere(Matrix<const double> G, Vector<const double> g, double radius,
                          Vector<double> y, const SphereSpace& space) {
    const long m = y.size[0];
    const Matrix<double> V{space.V, {m, m}};
    double *mu = space.mu, *above = space.above, *t = space.t, *z = space.z;
    for (long e = 0; e < m * m; ++e) space.A[e] = G.data[e];
    symmetric_eigen({space.A, {m, m}}, {mu, {m}}, V);
    double before = 0, length = 0;
    for (long i = 0; i < m; ++i) {
        above[i] = mu[i] - mu[0];
        t[i] = z[i] = 0;
        before += V[0][i] * y[i];
        for (long j = 0; j < m; ++j) t[i] += V[i][j] * g[j];
        length += square(t[i]);
    }
    const double size = root(length) / radius + above[m - 1];  // of G + multiplier I
    double start = 0;
    for (long i = 0; i < m; ++i) {
        if (above[i] <= ROUNDING * size) {
            above[i] = 0;
            if (magnitude(t[i]) <= ROUNDING * size * radius) t[i] = 0;
        }
        start = larger(start, magnitude(t[i]) / radius - above[i]);
    }
    auto [shift, reached] = find_root(above, t, radius, start, z, m);
    if (shift == 0) {
        z[0] = copysign(root(larger(square(radius) - reached, 0)), before);
        reached += square(z[0]);
    }
    const double scale = radius / root(reached);
    for (long i = 0; i < m; ++i) y[i] = 0;
    for (long j = 0; j < m; ++j)
        for (long i = 0; i < m; ++i) y[i] += scale * z[j] * V[j][i];
    return shift - mu[0];
}

double minimise_on_sphere_alone(Matrix<const double> G, Vector<const double> g, double radius,
                                Vector<double> y) {
    Workspace workspace;
    return minimise_on_sphere(G, g, radius, y, sphere_space(workspace, y.size[0]));
}

const Exported<minimise_on_sphere_alone> minimise_on_sphere_exported{"minimise_on_sphere", PART};

}  // namespace shapefit
