#include "pursuit.hpp"

#include "../base/registry.hpp"
#include "../base/symmetric_eigen.hpp"
#include "../base/vectors.hpp"
#include "../atoms/reduction.hpp"
#include "data.hpp"
#include "chosen_shapes.hpp"
#include "sphere.hpp"

namespace shapefit {
namespace {

constexpr double FLAT = 1e-12;  // eigenvalue of S S^T beside the largest: a shape without extent

// Memory of the inner loop and of the choice of an atom.
struct PursuitSpace {
    Vector<double> y;  // (most,)
    double *G, *g;     // (most, most) and (most,)
    SphereSpace sphere;
    double *S, *back;     // (3, q)
    double* correlation;  // (1 + k,)
};

// M = argmin ||w - M S||^2 for S = sum_i y_i Q_i, of least norm; the minimum. energy = ||w||^2.
double aim_camera(const ChosenShapes& chosen, Vector<const double> y, double energy, double* M) {
    double SS[9] = {}, D[6] = {}, extent[3], axes[9];  // S S^T and w S^T
    for (long i = 0; i < chosen.count; ++i) {
        add_to(D, y[i], chosen.Z[i].data, 6);
        for (long j = 0; j < chosen.count; ++j) add_to(SS, y[i] * y[j], chosen.N[i][j].data, 9);
    }
    symmetric_eigen({SS, {3, 3}}, {extent, {3}}, {axes, {3, 3}});
    double explained = 0;
    for (int e = 0; e < 6; ++e) M[e] = 0;
    for (int e = 0; e < 3; ++e) {
        if (!(extent[e] > FLAT * extent[2])) continue;
        for (int a = 0; a < 2; ++a) {
            const double along = dot(D + 3 * a, axes + 3 * e, 3);
            explained += square(along) / extent[e];
            add_to(M + 3 * a, along / extent[e], axes + 3 * e, 3);
        }
    }
    return larger(energy - explained, 0);
}

// y = argmin ||w - sum_i y_i M Q_i||^2 over ||y|| = length, from where y is.
void mix_shapes(const ChosenShapes& chosen, const double* M, double length, PursuitSpace& space) {
    const long m = chosen.count;
    double P[9];
    for (int a = 0; a < 3; ++a)
        for (int b = 0; b < 3; ++b) P[3 * a + b] = M[a] * M[b] + M[3 + a] * M[3 + b];
    for (long i = 0; i < m; ++i) {
        space.g[i] = dot(M, chosen.Z[i].data, 6);
        for (long j = 0; j <= i; ++j)
            space.G[i * m + j] = space.G[j * m + i] = dot(P, chosen.N[i][j].data, 9);
    }
    minimise_on_sphere({space.G, {m, m}}, {space.g, {m}}, length, {space.y.data, {m}},
                       space.sphere);
}

// |<w - M S, M B_i>| of the free shapes, -1 for the others.
void correlate(const ReducedImage& image, const ChosenShapes& chosen, const double* M,
               PursuitSpace& space) {
    const long q = image.w.size[1];
    double *S = space.S, *back = space.back;
    for (long e = 0; e < 3 * q; ++e) S[e] = 0;
    for (long i = 0; i < chosen.count; ++i) add_to(S, space.y[i], chosen.Q[i].data, 3 * q);
    const double *x = image.w[0].data, *y = image.w[1].data;
    for (long j = 0; j < q; ++j) {
        const double u = x[j] - M[0] * S[j] - M[1] * S[q + j] - M[2] * S[2 * q + j];
        const double v = y[j] - M[3] * S[j] - M[4] * S[q + j] - M[5] * S[2 * q + j];
        for (int b = 0; b < 3; ++b) back[b * q + j] = M[b] * u + M[3 + b] * v;
    }
    for (long i = 0; i < image.shapes.size[0]; ++i)
        space.correlation[i] =
            chosen.free[i] ? magnitude(dot(back, image.shapes[i].data, 3 * q)) : -1;
}

// Choose the free atom of the largest correlation whose limbs are no mixture of the chosen ones';
// false where there is none.
bool choose_atom(const ReducedImage& image, const double* M, ChosenShapes& chosen,
                 PursuitSpace& space) {
    correlate(image, chosen, M, space);
    for (;;) {
        long best = 0;
        for (long i = 1; i < image.shapes.size[0]; ++i)
            if (space.correlation[i] > space.correlation[best]) best = i;
        if (space.correlation[best] < 0) return false;
        if (choose_shape(best, image, chosen)) return true;
        space.correlation[best] = -1;
    }
}

struct Pursued {
    double error;
    long rounds;
};

// Add atoms until ||w - M S||^2 <= goal; writes c (1 + k,) and M (2, 3).
Pursued pursue_image(const ReducedImage& image, const PursuitRules& rules, ChosenShapes& chosen,
                     PursuitSpace& space, Vector<double> c, double* M) {
    const long shapes = c.size[0];
    const double energy = dot(image.w.data, image.w.data, 2 * image.w.size[1]);
    for (long i = 0; i < shapes; ++i) chosen.free[i] = true;
    for (long i = 0; i < chosen.most; ++i) space.y[i] = 0;
    chosen.count = 0;
    choose_shape(0, image, chosen);
    space.y[0] = rules.length;
    double error = aim_camera(chosen, {space.y.data, {chosen.most}}, energy, M);
    long rounds = 0;
    while (error > rules.goal && chosen.count < chosen.most) {
        if (!choose_atom(image, M, chosen, space)) break;
        for (long round = 0; round < rules.most_rounds; ++round) {
            const double before = error;
            mix_shapes(chosen, M, rules.length, space);
            error = aim_camera(chosen, {space.y.data, {chosen.most}}, energy, M);
            ++rounds;
            if (magnitude(before - error) < rules.change) break;
        }
    }
    for (long i = 0; i < shapes; ++i) c[i] = 0;
    for (long i = 0; i < chosen.count; ++i) add_to(c.data, space.y[i], chosen.T[i].data, shapes);
    return {error, rounds};
}

bool equal(Vector<const double> a, Vector<const double> b) {
    for (long j = 0; j < a.size[0]; ++j)
        if (a[j] != b[j]) return false;
    return true;
}

}  // namespace

void pursue(const PursuitData& data, Range range) {
    const long p = data.landmarks.size[2], shapes = data.shapes.size[0];
    const long most = data.rules.most_atoms + 1;
    Workspace workspace;
    ChosenShapes chosen = room_for_shapes(workspace, most, shapes, p, data.limbs.size[1]);
    PursuitSpace space{workspace.vector<double>(most),        workspace.zeros<double>(most * most),
                       workspace.zeros<double>(most),         sphere_space(workspace, most),
                       workspace.zeros<double>(3 * p),        workspace.zeros<double>(3 * p),
                       workspace.zeros<double>(shapes)};
    Reduction reduction(workspace, p);
    double *w = workspace.zeros<double>(2 * p), *reduced = workspace.zeros<double>(shapes * 3 * p);
    for (long i = range.first; i < range.last; ++i) {
        const Vector<const double> omega = data.weights[i];
        if (i == range.first || !equal(omega, data.weights[i - 1])) {
            reduction.find(omega);
            if (reduction.seen > 1)
                for (long row = 0; row < 3 * shapes; ++row)
                    reduction.reduce(data.shapes.data + row * p, omega.data,
                                     reduced + row * reduction.coordinates());
        }
        const long q = reduction.coordinates();
        if (q < 1) {
            data.status[i] = LocalStatus::DEGENERATE;
            continue;
        }
        reduction.reduce_landmarks(data.landmarks[i], omega.data, w, q);
        if (!is_finite(dot(w, w, 2 * q) + dot(reduced, reduced, 3 * q))) {
            data.status[i] = LocalStatus::FAILED;
            continue;
        }
        chosen.Q.size[2] = q;
        const ReducedImage image{{w, {2, q}}, {reduced, {shapes, 3, q}}, data.limbs};
        const auto [error, rounds] = pursue_image(image, data.rules, chosen, space,
                                                  data.coefficients[i], data.cameras[i].data);
        data.errors[i] = error;
        data.rounds[i] = rounds;
        data.status[i] = error <= data.rules.goal ? LocalStatus::CONVERGED : LocalStatus::ITERATION_LIMIT;
    }
}

const Exported<pursue> pursue_exported{"pursue"};

}  // namespace shapefit
