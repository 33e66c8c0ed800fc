// Projected matching pursuit (Ramakrishna, Kanade and Sheikh 2012): atoms one after another, limbs of a
// fixed total length.
//
//     min ||w - M sum_i y_i Q_i||^2 over M (2, 3) and ||y|| = length,
//
// in turn over y, globally, and over M, for the chosen shapes; then the atom with the largest
// |<w - M S, M B_i>| joins them, until the error is small enough. The chosen shapes are mixed into Q_i
// whose limb vectors U_i are orthonormal (those of the mean first), so that the sum of squared limb
// lengths of sum_i y_i Q_i is ||y||^2. All that the inner loop needs of the reduced landmarks w (2, q)
// and the Q_i (3, q) are the small products N_ij = Q_i Q_j^T and Z_i = w Q_i^T.
#include "../atoms/reduced_atoms.hpp"
#include "../base/registry.hpp"
#include "../base/small_matrices.hpp"

namespace shapefit {

// n images over 1 + k shapes, the mean first.
struct PursuitData {
    Arguments& from;
    Tensor<const double> landmarks = from("landmarks", "n 2 p");  // W
    Matrix<const double> weights = from("weights", "n p");        // Omega
    Tensor<const double> shapes = from("shapes", "1+k 3 p");
    Matrix<const double> limbs = from("limbs", "1+k l");  // limb vectors of the shapes
    double length = from("length");  // root of the sum of squared limb lengths of the mixture
    double goal = from("goal");      // squared error at which no more atoms join
    double change = from("change");  // of the squared error, at which the inner loop ends
    long most_atoms = from("most_atoms");
    long most_rounds = from("most_rounds");                   // of an inner loop
    Matrix<double> coefficients = from("coefficients", "n 1+k");  // c, zeros
    Tensor<double> cameras = from("cameras", "n 2 3");            // M
    Vector<double> errors = from("errors", "n");                  // ||w - M S||^2
    Vector<int64_t> rounds = from("rounds", "n");                 // of all inner loops
    Vector<int64_t> status = from("status", "n");
};

namespace {

constexpr double ROUNDING = 64 * 0x1p-52;
constexpr int MOST_STEPS = 100;         // of Newton's method for the secular equation
constexpr double INDEPENDENT = 1e-8;    // share of squared limb lengths that the chosen ones lack
constexpr double FLAT = 1e-12;  // eigenvalue of S S^T beside the largest: a shape without extent

// argmin y^T G y - 2 g^T y over ||y|| = radius, for symmetric G (m, m), is where
// (G + multiplier I) y = g and G + multiplier I is positive semidefinite: at the largest root of
//
//     sum_i (t_i / (mu_i + multiplier))^2 = radius^2,      G = V^T diag(mu) V, t = V g.
//
// 1 / ||y|| is a concave function of the multiplier right of the last pole: Newton's method from
// the left of the root never overshoots. Where g has no part along the least eigenvalue the pole
// may be none, and the root may lie left of it: then the multiplier is the pole and the
// eigenvector fills up y (the hard case). Source: Gander 1981; More and Sorensen 1983.
class Sphere {
  public:
    Sphere(Workspace& workspace, long most)
        : A_(workspace.zeros<double>(most * most)),
          V_(workspace.zeros<double>(most * most)),
          mu_(workspace.zeros<double>(most)),
          above_(workspace.zeros<double>(most)),
          t_(workspace.zeros<double>(most)),
          z_(workspace.zeros<double>(most)) {}

    // Overwrite y (m,) with the minimiser, of two the one nearer to what it was; the multiplier.
    double minimise(const double* G, const double* g, double radius, Vector<double> y) const {
        const long m = y.size[0];
        const Matrix<double> V{V_, {m, m}};
        for (long e = 0; e < m * m; ++e) A_[e] = G[e];
        symmetric_eigen({A_, {m, m}}, {mu_, {m}}, V);
        double before = 0, length = 0;
        for (long i = 0; i < m; ++i) {
            above_[i] = mu_[i] - mu_[0];
            t_[i] = z_[i] = 0;
            before += V[0][i] * y[i];
            for (long j = 0; j < m; ++j) t_[i] += V[i][j] * g[j];
            length += square(t_[i]);
        }
        const double size = root(length) / radius + above_[m - 1];  // of G + multiplier I
        double start = 0;
        for (long i = 0; i < m; ++i) {
            if (above_[i] <= ROUNDING * size) {
                above_[i] = 0;
                if (magnitude(t_[i]) <= ROUNDING * size * radius) t_[i] = 0;
            }
            start = larger(start, magnitude(t_[i]) / radius - above_[i]);
        }
        auto [shift, reached] = find_root(radius, start, m);
        if (shift == 0) {
            z_[0] = copysign(root(larger(square(radius) - reached, 0)), before);
            reached += square(z_[0]);
        }
        const double scale = radius / root(reached);
        for (long i = 0; i < m; ++i) y[i] = 0;
        for (long j = 0; j < m; ++j)
            for (long i = 0; i < m; ++i) y[i] += scale * z_[j] * V[j][i];
        return shift - mu_[0];
    }

  private:
    struct Root {
        double shift;   // of the multiplier from the pole
        double square;  // ||z||^2, y = V^T z
    };

    // The largest root, right of the pole or on it; z is written. `shift` starts left of the root.
    Root find_root(double radius, double shift, long m) const {
        double square = 0;
        for (int step = 0; step < MOST_STEPS; ++step) {
            double slope = 0;
            square = 0;
            for (long i = 0; i < m; ++i) {
                if (t_[i] == 0) continue;
                z_[i] = t_[i] / (above_[i] + shift);
                square += z_[i] * z_[i];
                slope += z_[i] * z_[i] / (above_[i] + shift);
            }
            const double excess = root(square) / radius - 1;
            if (excess <= ROUNDING) break;
            shift += excess * square / slope;
        }
        return {shift, square};
    }

    double *A_, *V_;                  // (m, m)
    double *mu_, *above_, *t_, *z_;  // (m,)
};

// out (r, 3) = A B^T for padded rows A (r, row) and B (3, row).
void multiply(const double* A, long r, const double* B, long row, double* out) {
    for (long a = 0; a < r; ++a)
        for (long b = 0; b < 3; ++b) out[3 * a + b] = dot_padded(A + a * row, B + b * row, row);
}

class Pursuit {
  public:
    Pursuit(Workspace& workspace, const PursuitData& data)
        : data_(data),
          shapes_(data.shapes.size[0]),
          most_(data.most_atoms + 1),
          image_(workspace, data.shapes),
          size_(dot(data.shapes.data, data.shapes.data, shapes_ * 3 * data.shapes.size[2])),
          sphere_(workspace, most_),
          Q_(workspace.zeros<double>(most_ * 3 * padded(data.shapes.size[2]))),
          U_(workspace.matrix<double>(most_, data.limbs.size[1])),
          T_(workspace.matrix<double>(most_, shapes_)),
          N_(workspace.tensor<double>(most_, most_, 9)),
          Z_(workspace.matrix<double>(most_, 6)),
          free_(workspace.zeros<bool>(shapes_)),
          y_(workspace.zeros<double>(most_)),
          G_(workspace.zeros<double>(most_ * most_)),
          g_(workspace.zeros<double>(most_)),
          S_(workspace.zeros<double>(3 * padded(data.shapes.size[2]))),
          back_(workspace.zeros<double>(3 * padded(data.shapes.size[2]))),
          correlation_(workspace.zeros<double>(padded(shapes_))) {}

    // Add atoms until ||w - M S||^2 <= goal.
    int64_t pursue(long image) {
        if (!image_.take(data_.landmarks[image], data_.weights[image])) return Status::DEGENERATE;
        energy_ = dot_padded(image_.w, image_.w, 2 * image_.atoms.row);
        if (!is_finite(energy_ + size_)) return Status::NUMERICAL_FAILURE;
        double* M = data_.cameras[image].data;
        begin();
        double error = aim_camera(M);
        while (error > data_.goal && count_ < most_ && choose_atom(M))
            for (long round = 0; round < data_.most_rounds; ++round) {
                const double before = error;
                mix_shapes(M);
                error = aim_camera(M);
                ++data_.rounds[image];
                if (magnitude(before - error) < data_.change) break;
            }
        const Vector<double> c = data_.coefficients[image];
        for (long i = 0; i < count_; ++i) add_to(c.data, y_[i], T_[i].data, shapes_);
        data_.errors[image] = error;
        return error <= data_.goal ? Status::CONVERGED : Status::ITERATION_LIMIT;
    }

  private:
    double* Q(long i) const { return Q_ + i * 3 * image_.atoms.row; }

    // The mean shape alone.
    void begin() {
        for (long i = 0; i < shapes_; ++i) free_[i] = true;
        count_ = 0;
        choose_shape(0);
        y_[0] = data_.length;
    }

    // Append shape `added`, which is free no longer; false, and nothing is appended, where its limb
    // vectors depend on those of the chosen ones.
    bool choose_shape(long added) {
        const long m = count_, row = image_.atoms.row, l = U_.size[1];
        double *U = U_[m].data, *T = T_[m].data;
        const double *limbs = data_.limbs[added].data, *B = image_.atoms[added];
        free_[added] = false;
        for (long e = 0; e < l; ++e) U[e] = limbs[e];
        for (long e = 0; e < 3 * row; ++e) Q(m)[e] = B[e];
        for (long i = 0; i < shapes_; ++i) T[i] = i == added;
        for (int time = 0; time < 2; ++time)  // twice is enough for orthogonality to rounding
            for (long i = 0; i < m; ++i) {
                const double along = dot(U_[i].data, U, l);
                add_to(U, -along, U_[i].data, l);
                add_to(T, -along, T_[i].data, shapes_);
                add_to(Q(m), -along, Q(i), 3 * row);
            }
        const double rest = dot(U, U, l);
        if (!(rest > INDEPENDENT * dot(limbs, limbs, l))) return false;
        const double scale = 1 / root(rest);
        for (long e = 0; e < l; ++e) U[e] *= scale;
        for (long i = 0; i < shapes_; ++i) T[i] *= scale;
        for (long e = 0; e < 3 * row; ++e) Q(m)[e] *= scale;
        multiply(image_.w, 2, Q(m), row, Z_[m].data);
        for (long i = 0; i <= m; ++i) {
            multiply(Q(m), 3, Q(i), row, N_[m][i].data);
            multiply(Q(i), 3, Q(m), row, N_[i][m].data);
        }
        y_[m] = 0;
        count_ = m + 1;
        return true;
    }

    // M = argmin ||w - M S||^2 for S = sum_i y_i Q_i, of least norm; the minimum.
    double aim_camera(double* M) const {
        double SS[9] = {}, D[6] = {}, extent[3], axes[9];  // S S^T and w S^T
        for (long i = 0; i < count_; ++i) {
            add_to(D, y_[i], Z_[i].data, 6);
            for (long j = 0; j < count_; ++j) add_to(SS, y_[i] * y_[j], N_[i][j].data, 9);
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
        return larger(energy_ - explained, 0);
    }

    // y = argmin ||w - sum_i y_i M Q_i||^2 over ||y|| = length, from where y is.
    void mix_shapes(const double* M) {
        const long m = count_;
        double P[9];
        for (int a = 0; a < 3; ++a)
            for (int b = 0; b < 3; ++b) P[3 * a + b] = M[a] * M[b] + M[3 + a] * M[3 + b];
        for (long i = 0; i < m; ++i) {
            g_[i] = dot(M, Z_[i].data, 6);
            for (long j = 0; j <= i; ++j) G_[i * m + j] = G_[j * m + i] = dot(P, N_[i][j].data, 9);
        }
        sphere_.minimise(G_, g_, data_.length, {y_, {m}});
    }

    // Choose the free atom of the largest |<w - M S, M B_i>| whose limbs are no mixture of the chosen
    // ones'; false where there is none.
    bool choose_atom(const double* M) {
        correlate(M);
        for (;;) {
            long best = 0;
            for (long i = 1; i < shapes_; ++i)
                if (correlation_[i] > correlation_[best]) best = i;
            if (correlation_[best] < 0) return false;
            if (choose_shape(best)) return true;
            correlation_[best] = -1;
        }
    }

    void correlate(const double* M) {
        const long q = image_.atoms.q(), row = image_.atoms.row;
        mix_rows(y_, count_, Q_, 3 * row, 3 * row, S_);
        for (long j = 0; j < q; ++j) {
            const double *S = S_ + j, *w = image_.w + j;
            const double u = w[0] - M[0] * S[0] - M[1] * S[row] - M[2] * S[2 * row];
            const double v = w[row] - M[3] * S[0] - M[4] * S[row] - M[5] * S[2 * row];
            for (int b = 0; b < 3; ++b) back_[b * q + j] = M[b] * u + M[3 + b] * v;
        }
        find_inner_products(image_.atoms.planes, back_, correlation_);
        for (long i = 0; i < shapes_; ++i)
            correlation_[i] = free_[i] ? magnitude(correlation_[i]) : -1;
    }

    const PursuitData& data_;
    const long shapes_, most_;
    ReducedImage image_;
    const double size_;  // sum of squares of all shapes
    double energy_ = 0;  // ||w||^2
    Sphere sphere_;
    long count_ = 0;    // chosen shapes
    double* Q_;         // (most, 3, row)
    Matrix<double> U_;  // (most, l)
    Matrix<double> T_;  // (most, 1 + k): Q_i = sum_j T_ij shapes_j
    Tensor<double> N_;  // (most, most, 9)
    Matrix<double> Z_;  // (most, 6)
    bool* free_;        // (1 + k): the shapes that may still join
    double *y_, *G_, *g_;  // (most,), (most, most), (most,)
    double *S_, *back_, *correlation_;  // (3, row), (3, q), (1 + k,)
};

// For tests.
double minimise_on_sphere(Matrix<const double> G, Vector<const double> g, double radius,
                          Vector<double> y) {
    Workspace workspace;
    return Sphere(workspace, y.size[0]).minimise(G.data, g.data, radius, y);
}

}  // namespace

void pursue(const PursuitData& data, Range range) {
    Workspace workspace;
    Pursuit pursuit(workspace, data);
    for (long i = range.first; i < range.last; ++i) data.status[i] = pursuit.pursue(i);
}

const Exported<pursue> pursue_exported{"pursue"};
const Exported<minimise_on_sphere> minimise_on_sphere_exported{"minimise_on_sphere", PART};

}  // namespace shapefit
