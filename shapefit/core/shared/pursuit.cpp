// Projected matching pursuit: atoms one after another, limbs of a fixed total length.
#include "../atoms/reduced_atoms.hpp"
#include "../base/registry.hpp"
#include "../base/lanes.hpp"
#include "../base/small_matrices.hpp"
#include "../base/vectors.hpp"
#include "../base/memory.hpp"
#include "data.hpp"

namespace shapefit {

// What projected matching pursuit reads and writes, as Python lays it out.

// When a pursuit ends, and what it keeps.
struct PursuitRules {
    Arguments& from;
    double length = from("length");  // root of the sum of squared limb lengths of the mixture
    double goal = from("goal");  // squared error at which no more atoms join
    // of the squared error in a round, at which the inner loop ends
    double change = from("change");
    long most_atoms = from("most_atoms");
    long most_rounds = from("most_rounds");  // of an inner loop
};

// n images over 1 + k shapes, the mean first.
struct PursuitData {
    Arguments& from;
    Tensor<const double> landmarks = from("landmarks", "n 2 p");  // W
    Matrix<const double> weights = from("weights", "n p");  // Omega
    Tensor<const double> shapes = from("shapes", "1+k 3 p");
    Matrix<const double> limbs = from("limbs", "1+k l");  // limb vectors of the shapes
    PursuitRules rules{from};
    Matrix<double> coefficients = from("coefficients", "n 1+k");  // c, zeros
    Tensor<double> cameras = from("cameras", "n 2 3");  // M
    Vector<double> errors = from("errors", "n");  // ||w - M S||^2
    Vector<int64_t> rounds = from("rounds", "n");  // of all inner loops
    Vector<int64_t> status = from("status", "n");
};

// Least squares on a sphere: the secular equation and its largest root.
//
// argmin y^T G y - 2 g^T y over ||y|| = radius, for symmetric G (m, m), is where
// (G + multiplier I) y = g and G + multiplier I is positive semidefinite: at the largest root of
//
//     sum_i (t_i / (mu_i + multiplier))^2 = radius^2,      G = V^T diag(mu) V, t = V g.
//
// 1 / ||y|| is a concave function of the multiplier right of the last pole: Newton's method from
// the left of the root never overshoots. Where g has no part along the least eigenvalue the pole
// may be none, and the root may lie left of it: then the multiplier is the pole and the
// eigenvector fills up y (the hard case). Source: Gander 1981; More and Sorensen 1983.

// Memory for problems of up to m unknowns.
struct SphereSpace {
    double *A, *V;             // (m, m)
    double *mu, *above, *t, *z;  // (m,)
};

SphereSpace sphere_space(Workspace& workspace, long m);

// Overwrite y (m,) with the minimiser, of two the one nearer to what it was; the multiplier.
double minimise_on_sphere(Matrix<const double> G, Vector<const double> g, double radius,
                          Vector<double> y, const SphereSpace& space);

// The same with memory of its own.
double minimise_on_sphere_alone(Matrix<const double> G, Vector<const double> g, double radius,
                                Vector<double> y);

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

// The shapes that a pursuit has chosen, orthonormal in their limb vectors.
//
// The chosen shapes are mixed into Q_i whose limb vectors U_i are orthonormal (those of the mean
// first), so that the sum of squared limb lengths of sum_i y_i Q_i is ||y||^2. All that the inner
// loop needs of the reduced landmarks w (2, q) and the Q_i (3, q) are the small products
// N_ij = Q_i Q_j^T and Z_i = w Q_i^T.

// One image without its translation, and all shapes as it sees them.
struct ReducedImage {
    Matrix<const double> w;       // (2, q)
    Tensor<const double> shapes;  // (1 + k, 3, q), the mean first
    Matrix<const double> limbs;   // (1 + k, l)
};

// Room for `most` chosen shapes, `count` of which are taken.
struct ChosenShapes {
    long most, count;
    Tensor<double> Q;  // (most, 3, q)
    Matrix<double> U;  // (most, l)
    Matrix<double> T;  // (most, 1 + k): Q_i = sum_j T_ij shapes_j
    Blocks<double> N;  // (most, most, 3, 3)
    Tensor<double> Z;  // (most, 2, 3)
    bool* free;        // (1 + k): the shapes that may still join
};

ChosenShapes room_for_shapes(Workspace& workspace, long most, long shapes, long q, long limbs);

// Append shape `added`, which is free no longer; false, and nothing is appended, where its limb
// vectors depend on those of the chosen ones.
bool choose_shape(long added, const ReducedImage& image, ChosenShapes& chosen);

namespace {

constexpr double INDEPENDENT = 1e-8;  // share of squared limb lengths that the chosen ones lack

// out (r, 3) = A B^T for A (r, q) and B (3, q).
void multiply(const double* A, long r, const double* B, long q, double* out) {
    for (long a = 0; a < r; ++a)
        for (long b = 0; b < 3; ++b) out[3 * a + b] = dot(A + a * q, B + b * q, q);
}

}  // namespace

ChosenShapes room_for_shapes(Workspace& workspace, long most, long shapes, long q, long limbs) {
    ChosenShapes chosen;
    chosen.most = most;
    chosen.count = 0;
    chosen.Q = workspace.tensor<double>(most, 3, q);
    chosen.U = workspace.matrix<double>(most, limbs);
    chosen.T = workspace.matrix<double>(most, shapes);
    chosen.N = {workspace.zeros<double>(most * most * 9), {most, most, 3, 3}};
    chosen.Z = workspace.tensor<double>(most, 2, 3);
    chosen.free = workspace.zeros<bool>(shapes);
    return chosen;
}

bool choose_shape(long added, const ReducedImage& image, ChosenShapes& chosen) {
    const long m = chosen.count, q = image.w.size[1], l = image.limbs.size[1];
    const long shapes = image.shapes.size[0];
    double *Q = chosen.Q[m].data, *U = chosen.U[m].data, *T = chosen.T[m].data;
    const double* limbs = image.limbs[added].data;
    chosen.free[added] = false;
    for (long e = 0; e < l; ++e) U[e] = limbs[e];
    for (long e = 0; e < 3 * q; ++e) Q[e] = image.shapes[added].data[e];
    for (long i = 0; i < shapes; ++i) T[i] = i == added;
    for (int time = 0; time < 2; ++time)  // twice is enough for orthogonality to rounding
        for (long i = 0; i < m; ++i) {
            const double along = dot(chosen.U[i].data, U, l);
            add_to(U, -along, chosen.U[i].data, l);
            add_to(T, -along, chosen.T[i].data, shapes);
            add_to(Q, -along, chosen.Q[i].data, 3 * q);
        }
    const double rest = dot(U, U, l);
    if (!(rest > INDEPENDENT * dot(limbs, limbs, l))) return false;
    const double scale = 1 / root(rest);
    for (long e = 0; e < l; ++e) U[e] *= scale;
    for (long i = 0; i < shapes; ++i) T[i] *= scale;
    for (long e = 0; e < 3 * q; ++e) Q[e] *= scale;
    multiply(image.w.data, 2, Q, q, chosen.Z[m].data);
    for (long i = 0; i <= m; ++i) {
        multiply(Q, 3, chosen.Q[i].data, q, chosen.N[m][i].data);
        multiply(chosen.Q[i].data, 3, Q, q, chosen.N[i][m].data);
    }
    chosen.count = m + 1;
    return true;
}

// Projected Matching Pursuit on one image after another (Ramakrishna, Kanade and Sheikh 2012).
//
//     min ||w - M sum_i y_i Q_i||^2 over M (2, 3) and ||y|| = length,
//
// in turn over y, globally, and over M, for the chosen shapes; then the atom with the largest
// |<w - M S, M B_i>| joins them, until the error is small enough.

void pursue(const PursuitData& data, Range range);

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
        if (i == range.first || !are_equal(omega.data, data.weights[i - 1].data, p)) {
            reduction.find(omega);
            if (reduction.seen > 1)
                for (long row = 0; row < 3 * shapes; ++row)
                    reduction.reduce(data.shapes.data + row * p, omega.data,
                                     reduced + row * reduction.coordinates());
        }
        const long q = reduction.coordinates();
        if (q < 1) {
            data.status[i] = Status::DEGENERATE;
            continue;
        }
        reduction.reduce_landmarks(data.landmarks[i], omega.data, w, q);
        if (!is_finite(dot(w, w, 2 * q) + dot(reduced, reduced, 3 * q))) {
            data.status[i] = Status::NUMERICAL_FAILURE;
            continue;
        }
        chosen.Q.size[2] = q;
        const ReducedImage image{{w, {2, q}}, {reduced, {shapes, 3, q}}, data.limbs};
        const auto [error, rounds] = pursue_image(image, data.rules, chosen, space,
                                                  data.coefficients[i], data.cameras[i].data);
        data.errors[i] = error;
        data.rounds[i] = rounds;
        data.status[i] = error <= data.rules.goal ? Status::CONVERGED : Status::ITERATION_LIMIT;
    }
}

const Exported<pursue> pursue_exported{"pursue"};

}  // namespace shapefit
