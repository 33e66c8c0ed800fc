// The posterior over shape and view of each image: one mode after another, and all of them combined.
#include "../base/small_matrices.hpp"
#include "../base/vectors.hpp"
#include "search.hpp"

namespace shapefit {
namespace {

constexpr double SAME_VIEW = 1e-2;    // rotations as close are one mode (Frobenius norm)
constexpr double NO_MAXIMUM = 50;     // what a point that is none loses, in log evidence
constexpr double NEGLIGIBLE = 6;      // a mode so far below the best in log evidence is left out
constexpr double LAPLACE = 1;         // by which the view integrated out may lift one over another
constexpr int MIXED[3][2] = {{0, 1}, {0, 2}, {1, 2}};  // coordinates of a landmark

struct Mode {
    long component;
    Rotation R;
    double log_scale;
    double log_evidence;
    double squared_mahalanobis;
    bool stationary;            // nothing is left to climb, and every way leads down
    double root[VIEW * VIEW];   // W with W^T W = (H + I)^-1, the covariance of the view
    double* inlier_probability;  // (m,)
};

struct ModeSpace {
    ModeSpace(Workspace& workspace, long p) : workspace(workspace), p(p) {}

    Workspace& workspace;
    const long p;
    const long D = padded(3 * p), n = padded(2 * p);  // rows are padded

    // C turned into the frame of the camera; then the covariance of y (3p, 3p).
    Matrix<double> C = workspace.matrix<double>(D, D);
    Matrix<double> K = workspace.matrix<double>(n, D);  // P C and the translation, as rows (2m, 3p)
    Matrix<double> U = workspace.matrix<double>(n, D);  // s S^-1/2 K (2m, 3p)
    Matrix<double> J = workspace.matrix<double>(VIEW, D);  // derivatives of y over theta (4, 3p)
    // S and its Cholesky factor, and the inverse of that (2m, 2m)
    double *S = workspace.zeros<double>(n * n), *V = workspace.zeros<double>(n * n);
    Vector<double> y = workspace.vector<double>(n), alpha = workspace.vector<double>(n);
    Vector<double> white = workspace.vector<double>(n), change = workspace.vector<double>(n);
    Vector<double> mean = workspace.vector<double>(D), X = workspace.vector<double>(D);
    Vector<double> turned = workspace.vector<double>(2 * D);
};

// (R x I) x for x (3, p).
void rotate_shape(const double* R, const double* x, long p, double* __restrict out) {
    for (int a = 0; a < 3; ++a)
        for (long j = 0; j < p; ++j)
            out[a * p + j] = R[3 * a] * x[j] + R[3 * a + 1] * x[p + j] + R[3 * a + 2] * x[2 * p + j];
}

// C <- (R x I) C (R x I)^T
void rotate_covariance(const double* R, const double* given, long p, ModeSpace& space) {
    const long d = 3 * p, D = padded(d);
    for (long i = 0; i < d; ++i) rotate_shape(R, given + i * d, p, space.C[i].data);
    for (long j = 0; j < p; ++j) {
        double *x = space.C[j].data, *y = x + p * D, *z = y + p * D;
        for (long e = 0; e < d; ++e) {
            const double cx = x[e], cy = y[e], cz = z[e];
            x[e] = R[0] * cx + R[1] * cy + R[2] * cz;
            y[e] = R[3] * cx + R[4] * cy + R[5] * cz;
            z[e] = R[6] * cx + R[7] * cy + R[8] * cz;
        }
    }
}

// Row i of P x, the landmark seen along its ray, for x (3, p).
double project_row(const Observed<double>& seen, long i, const double* x, long p) {
    return x[i % 2 * p + seen.index[i / 2]] - seen.slope[i] * x[2 * p + seen.index[i / 2]];
}

// K = P C + TAU^2, V with V^T V = S^-1, and alpha; rows after the N seen are those of ones.
void factorise(const Observed<double>& seen, const Mode& mode, double s, ModeSpace& space) {
    const long p = space.p, d = 3 * p, N = 2 * seen.m, n = padded(N);
    for (long i = 0; i < N; ++i) {
        double* row = space.K[i].data;
        const double *across = space.C[i % 2 * p + seen.index[i / 2]].data;
        const double *depth = space.C[2 * p + seen.index[i / 2]].data;
        for (long e = 0; e < d; ++e) row[e] = across[e] - seen.slope[i] * depth[e];
        for (long j = 0; j < p; ++j) row[i % 2 * p + j] += TAU_SQUARE;
    }
    for (long i = 0; i < n; ++i)
        for (long k = 0; k < n; ++k)
            space.S[i * n + k] = i < N && k < N ? project_row(seen, k, space.K[i].data, p) : i == k ? 1.0 : 0.0;
    for (long j = 0; j < seen.m; ++j) {
        const double *V = seen.noise + 3 * j, share = 1 / mode.inlier_probability[j];
        double* at = space.S + 2 * j * (n + 1);
        at[0] += (seen.residual_variance[j] + V[0] / (s * s)) * share;
        at[1] += V[1] / (s * s) * share;
        at[n + 1] += (seen.residual_variance[j] + V[2] / (s * s)) * share;
    }
    factorise_block(space.S, space.V, n, n);
    for (long i = 0; i < n; ++i)
        space.alpha[i] = i < N ? space.y[i] - project_row(seen, i, space.mean.data, p) : 0.0;
}

// x <- S^-1 x for n numbers, zeros after those seen.
void solve(ModeSpace& space, long n, double* x) {
    for (long i = 0; i < n; ++i) space.white[i] = dot_padded(space.V + i * n, x, n);
    mix_rows(space.white.data, n, space.V, n, n, x);
}

// out = G_i x for x (3, p), G_i the turn about axis i; transposed: G_i^T x = -G_i x.
void apply_generator(int axis, const double* x, long p, double* __restrict out) {
    const int b = (axis + 1) % 3, c = (axis + 2) % 3;
    for (long j = 0; j < p; ++j) {
        out[axis * p + j] = 0;
        out[b * p + j] = -x[c * p + j];
        out[c * p + j] = x[b * p + j];
    }
}

// The derivatives J of y = s (X + t) over theta.
//
// A turn G: dX = G X + C G^T P^T alpha + K^T d(alpha), d(alpha) = -S^-1 P (G X + C G^T P^T alpha);
// log s: d(alpha) = S^-1 (-y + 2 V / (s^2 q) alpha).
void differentiate(const Observed<double>& seen, const Mode& mode, double s, ModeSpace& space,
                   const double* shape) {
    const long p = space.p, d = 3 * p, D = padded(d), N = 2 * seen.m, n = padded(N);
    double *change = space.change.data, *raised = space.turned.data, *spun = raised + D;
    for (long e = 0; e < d; ++e) raised[e] = 0;  // P^T alpha
    for (long i = 0; i < N; ++i) {
        raised[i % 2 * p + seen.index[i / 2]] = space.alpha[i];
        raised[2 * p + seen.index[i / 2]] -= seen.slope[i] * space.alpha[i];
    }
    for (int i = 0; i < VIEW; ++i) {
        double* J = space.J[i].data;
        for (long e = 0; e < D; ++e) J[e] = 0;
        for (long e = 0; e < n; ++e) change[e] = 0;
        if (i < 3) {
            apply_generator(i, raised, p, spun);
            mix_rows(spun, d, space.C.data, D, D, J);
            apply_generator(i, space.X.data, p, spun);
            for (long e = 0; e < d; ++e) J[e] = spun[e] - J[e];
            for (long e = 0; e < N; ++e) change[e] = -project_row(seen, e, J, p);
        } else {
            for (long j = 0; j < seen.m; ++j) {
                const double *V = seen.noise + 3 * j, *alpha = space.alpha.data + 2 * j;
                const double share = 2 / (s * s * mode.inlier_probability[j]);
                change[2 * j] = share * (V[0] * alpha[0] + V[1] * alpha[1]) - space.y[2 * j];
                change[2 * j + 1] = share * (V[1] * alpha[0] + V[2] * alpha[1]) - space.y[2 * j + 1];
            }
        }
        solve(space, n, change);
        mix_rows(change, N, space.K.data, D, D, spun);
        for (long e = 0; e < d; ++e) J[e] = s * (J[e] + spun[e]) + (i == 3 ? shape[e] : 0.0);
    }
}

// J <- W J
void whiten_view(const Mode& mode, ModeSpace& space) {
    const long D = space.J.size[1];
    for (long e = 0; e < D; e += WIDTH) {
        Doubles row[VIEW];
        for (int i = 0; i < VIEW; ++i) row[i] = load(space.J[i].data + e);
        for (int i = 0; i < VIEW; ++i) {
            Doubles total = {};
            for (int j = 0; j < VIEW; ++j) total += mode.root[VIEW * i + j] * row[j];
            store(space.J[i].data + e, total);
        }
    }
}

// Take the mean depth out of a vector.
void centre_depth(double* x, long p) {
    double mean = 0;
    for (long j = 0; j < p; ++j) mean += x[2 * p + j];
    for (long j = 0; j < p; ++j) x[2 * p + j] -= mean / static_cast<double>(p);
}

void centre_covariance(ModeSpace& space, long p) {
    const long d = 3 * p;
    for (long e = 0; e < d; ++e) centre_depth(space.C[e].data, p);
    double* mean = space.turned.data;
    for (long e = 0; e < d; ++e) mean[e] = 0;
    for (long j = 0; j < p; ++j) add_to(mean, 1 / static_cast<double>(p), space.C[2 * p + j].data, d);
    for (long j = 0; j < p; ++j) add_to(space.C[2 * p + j].data, -1, mean, d);
}

// C_ef += factor sum_i U_ie U_if for `count` rows of U: all of it or, for each landmark, that of x, y
// and z above the diagonal.
void add_squares(double factor, Matrix<double> U, long count, bool whole, ModeSpace& space) {
    const long p = space.p, D = U.size[1];
    if (whole)
        add_product(factor, transposed(U.data, D), U.data, space.C.data, D, D, D, D, every(count));
    else
        for (int a = 0; a < 3; ++a)
            for (int b = a; b < 3; ++b) {
                double* __restrict total = space.turned.data;
                for (long j = 0; j < p; ++j) total[j] = 0;
                for (long i = 0; i < count; ++i) {
                    const double *left = U[i].data + a * p, *right = U[i].data + b * p;
                    for (long j = 0; j < p; ++j) total[j] += left[j] * right[j];
                }
                for (long j = 0; j < p; ++j) space.C[a * p + j][b * p + j] += factor * total[j];
            }
}

// Mean y (3p,) with mean depth 0; its covariance, the uncertainty of the view included, in `space.C`:
// the `whole`, or of each landmark x with y and z, and y with z.
void describe(const PosteriorData& data, const Observed<double>& seen, const Mode& mode, ModeSpace& space,
              bool whole, double* mean) {
    const long p = data.landmarks.size[2], d = 3 * p, D = padded(d), N = 2 * seen.m, n = padded(N);
    const double s = exp(mode.log_scale);
    rotate_covariance(mode.R, data.covariances[mode.component].data, p, space);
    rotate_shape(mode.R, data.means[mode.component].data, p, space.mean.data);
    for (long i = 0; i < N; ++i) space.y[i] = seen.w[i] / s;
    factorise(seen, mode, s, space);
    solve(space, n, space.alpha.data);
    // X + t, and X without the translation
    double* moved = space.turned.data;
    mix_rows(space.alpha.data, N, space.K.data, D, D, moved);
    double shift[2] = {};
    for (long i = 0; i < N; ++i) shift[i % 2] += TAU_SQUARE * space.alpha[i];
    for (long e = 0; e < d; ++e) {
        const double y = space.mean[e] + moved[e];
        mean[e] = s * y;
        space.X[e] = y - (e < 2 * p ? shift[e / p] : 0.0);
    }
    differentiate(seen, mode, s, space, mean);
    whiten_view(mode, space);
    centre_depth(mean, p);
    // the covariance of s (X + t): s^2 (C + TAU^2 - K^T S^-1 K) + J^T H^-1 J
    for (long e = 0; e < n * D; ++e) space.U.data[e] = 0;
    for (long i = N; i < n; ++i)
        for (long e = 0; e < D; ++e) space.K[i][e] = 0;
    add_product(s, plain(space.V, n), space.K.data, space.U.data, n, D, D, D, up_to_row());
    for (long e = 0; e < d; ++e)
        for (long f = 0; f < d; ++f)
            space.C[e][f] *= s * s;
    for (int a = 0; a < 2; ++a)
        for (long j = 0; j < p; ++j)
            for (long k = 0; k < p; ++k) space.C[a * p + j][a * p + k] += s * s * TAU_SQUARE;
    centre_covariance(space, p);
    for (long i = 0; i < N; ++i) centre_depth(space.U[i].data, p);
    for (int i = 0; i < VIEW; ++i) centre_depth(space.J[i].data, p);
    add_squares(-1, space.U, N, whole, space);
    add_squares(1, space.J, VIEW, whole, space);
}

// The modes of an image; `order` begins with those that count, the best first.
struct Modes {
    Modes(Workspace& workspace, long most, long p)
        : modes(workspace.zeros<Mode>(most)), order(workspace.zeros<long>(most)) {
        for (long i = 0; i < most; ++i) modes[i].inlier_probability = workspace.zeros<double>(p);
    }

    const Mode& operator[](long i) const { return modes[order[i]]; }

    Mode* modes;
    long* order;
};

// The root of the covariance of the view, (H + I)^-1, where no direction is less than flat; returns
// log det (H + I), and whether H is positive definite.
struct Curvature {
    double log_det;
    bool definite;
};

Curvature weigh_view(const Climb<Doubles>& at, long lane, double* root_of) {
    double H[VIEW * VIEW], values[VIEW], axes[VIEW * VIEW], log_det = 0;
    for (int e = 0; e < VIEW * VIEW; ++e) H[e] = at.curvature[e][lane];
    symmetric_eigen({H, {VIEW, VIEW}}, {values, {VIEW}}, {axes, {VIEW, VIEW}});
    for (int i = 0; i < VIEW; ++i) {
        const double lifted = larger(values[i], 0.0) + CURVATURE_OF_PRIOR;
        log_det += log(lifted);
        for (int e = 0; e < VIEW; ++e) root_of[VIEW * i + e] = axes[VIEW * i + e] / root(lifted);
    }
    return {log_det, values[0] > 1e-6};
}

// The point on which climb i ended, with its evidence.
void weigh(const PosteriorData& data, const Search& search, long i, Mode& mode) {
    const Climbs<Doubles>& climbs = search.arrived;
    Climb<Doubles>& at = climbs[i];
    const long lane = i % WIDTH;
    const Curvature curvature = weigh_view(at, lane, mode.root);
    mode.stationary = curvature.definite && !(at.moving[lane] > 0);
    mode.component = climbs.pair[i] % data.means.size[0];
    for (int e = 0; e < 9; ++e) mode.R[e] = at.view.R[e][lane];
    mode.log_scale = at.view.log_scale[lane];
    for (long j = 0; j < search.late.seen.m; ++j) mode.inlier_probability[j] = at.inlier_probability[j][lane];
    mode.squared_mahalanobis = at.found.squared_mahalanobis[lane];
    mode.log_evidence = at.found.value[lane] + data.log_weights[mode.component] +
                        0.5 * (VIEW * LOG_TWO_PI - curvature.log_det);
    // A saddle, or a point on the way, counts only where no climb ends on a maximum.
    if (!mode.stationary) mode.log_evidence -= NO_MAXIMUM;
}

// Sort by evidence and leave out what was found before and what is negligible.
long rank(Modes& search, long count) {
    for (long i = 0; i < count; ++i) {
        long place = i;
        for (; place > 0 && search.modes[search.order[place - 1]].log_evidence <
                                search.modes[i].log_evidence;
             --place)
            search.order[place] = search.order[place - 1];
        search.order[place] = i;
    }
    long kept = 0;
    for (long i = 0; i < count; ++i) {
        const Mode& mode = search.modes[search.order[i]];
        if (mode.log_evidence < search.modes[search.order[0]].log_evidence - NEGLIGIBLE) break;
        bool known = false;
        for (long o = 0; o < kept && !known; ++o) {
            const Mode& other = search.modes[search.order[o]];
            double apart = 0;
            for (int e = 0; e < 9; ++e) apart += square(mode.R[e] - other.R[e]);
            known = other.component == mode.component && apart < SAME_VIEW * SAME_VIEW;
        }
        if (!known) search.order[kept++] = search.order[i];
    }
    return kept;
}

void fill(double* x, long n, double value) {
    for (long e = 0; e < n; ++e) x[e] = value;
}

// Mean and covariance of a mixture, from one mode to the next: deviations and MIXED correlations, and
// the whole covariance where there is room for it.
class Mixture {
  public:
    Mixture(const PosteriorData& data, long image)
        : p_(data.landmarks.size[2]),
          d_(3 * p_),
          mean_(data.mean[image].data),
          squares_(data.deviation[image].data),
          mixed_(data.correlation[image].data),
          whole_(data.covariance.size[0] ? data.covariance[image].data : nullptr) {}

    bool is_whole() const { return whole_; }

    void set_all(double value) {
        fill(mean_, d_, value);
        fill(squares_, d_, value);
        fill(mixed_, d_, value);
        if (whole_) fill(whole_, d_ * d_, value);
    }

    // The mean moves by the mode's share; what lies between joins the covariance.
    void add(double share, const double* mean, Matrix<const double> C) {
        const double step = share / (before_ + share), apart = before_ * step;
        const auto entry = [&](long e, long f) {
            return share * C[e][f] + apart * (mean[e] - mean_[e]) * (mean[f] - mean_[f]);
        };
        for (long e = 0; e < d_; ++e) squares_[e] += entry(e, e);
        for (long e = 0; e < d_; ++e) mixed_[e] += entry(first(e), second(e));
        for (long e = 0; whole_ && e < d_; ++e)
            for (long f = 0; f < d_; ++f) whole_[e * d_ + f] += entry(e, f);
        for (long e = 0; e < d_; ++e) mean_[e] += step * (mean[e] - mean_[e]);
        before_ += share;
    }

    // Squares become deviations, and covariances of MIXED correlations.
    void finish() {
        for (long e = 0; e < d_; ++e) squares_[e] = root(larger(squares_[e], 0.0));
        for (long e = 0; e < d_; ++e)
            mixed_[e] /= larger(squares_[first(e)] * squares_[second(e)], TINY);
    }

  private:
    long first(long e) const { return MIXED[e / p_][0] * p_ + e % p_; }
    long second(long e) const { return MIXED[e / p_][1] * p_ + e % p_; }

    const long p_, d_;
    double *mean_, *squares_, *mixed_, *whole_;
    double before_ = 0;  // the share of the modes so far
};

void fail(const PosteriorData& data, long image) {
    Mixture(data, image).set_all(NOT_A_NUMBER);
    fill(data.inlier_probability[image].data, data.landmarks.size[2], NOT_A_NUMBER);
    fill(data.rotation[image].data, 9, NOT_A_NUMBER);
    data.scale[image] = data.log_evidence[image] = data.squared_mahalanobis[image] = NOT_A_NUMBER;
    data.stationary[image] = false;
}

void store(const PosteriorData& data, long image, long rank, const Observed<double>& seen, const Mode& mode,
           const double* mean, Matrix<const double> covariance) {
    const long p = data.landmarks.size[2], d = 3 * p;
    data.mode_component[image][rank] = mode.component;
    data.mode_scale[image][rank] = exp(mode.log_scale);
    data.mode_log_evidence[image][rank] = mode.log_evidence;
    mode.R.write(data.mode_rotation[image][rank].data);
    for (long e = 0; e < d; ++e) data.mode_mean[image][rank].data[e] = mean[e];
    for (long e = 0; e < d; ++e)
        for (long f = 0; f < d; ++f) data.mode_covariance[image][rank][e][f] = covariance[e][f];
    const Vector<double> inlier_probability = data.mode_inlier_probability[image][rank];
    fill(inlier_probability.data, p, NOT_A_NUMBER);
    for (long j = 0; j < seen.m; ++j) inlier_probability[seen.index[j]] = mode.inlier_probability[j];
}

// The mixture of the first `kept` modes, by their evidence.
void combine(const PosteriorData& data, long image, const Observed<double>& seen, const Modes& modes,
             long kept, ModeSpace& space, double* mean) {
    const double best = modes[0].log_evidence;
    double total = 0, squared_mahalanobis = 0;
    for (long i = 0; i < kept; ++i) total += exp(modes[i].log_evidence - best);
    const Vector<double> inlier_probability = data.inlier_probability[image];
    fill(inlier_probability.data, data.landmarks.size[2], NOT_A_NUMBER);
    for (long j = 0; j < seen.m; ++j) inlier_probability[seen.index[j]] = 0;
    Mixture mixture(data, image);
    mixture.set_all(0);
    for (long i = 0; i < kept; ++i) {
        const Mode& mode = modes[i];
        const double share = exp(mode.log_evidence - best) / total;
        const bool is_stored = i < data.mode_component.size[1];
        describe(data, seen, mode, space, mixture.is_whole() || is_stored, mean);
        mixture.add(share, mean, space.C);
        squared_mahalanobis += share * mode.squared_mahalanobis;
        for (long j = 0; j < seen.m; ++j) inlier_probability[seen.index[j]] += share * mode.inlier_probability[j];
        if (is_stored) store(data, image, i, seen, mode, mean, space.C);
    }
    mixture.finish();
    modes[0].R.write(data.rotation[image].data);
    data.scale[image] = exp(modes[0].log_scale);
    data.log_evidence[image] = best + log(total);
    data.squared_mahalanobis[image] = squared_mahalanobis;
    data.stationary[image] = modes[0].stationary;
}

}  // namespace

// Climb from every start under every component; weigh the maxima by their evidence, the view
// integrated out by Laplace's approximation; mean and covariance of the mixture of those that count.
void find_posterior(const PosteriorData& data, Range range) {
    const long p = data.landmarks.size[2];
    Workspace workspace;
    Search search(workspace, data);
    ModeSpace space(workspace, p);
    Modes modes(workspace, data.starts.size[1] * data.means.size[0], p);
    double* mean = workspace.zeros<double>(3 * p);
    const Observed<double>& seen = search.late.seen;
    for (long image = range.first; image < range.last; ++image) {
        data.rounds[image] = 0;
        for (long i = 0; i < data.mode_component.size[1]; ++i) {
            data.mode_component[image][i] = -1;
            data.mode_log_evidence[image][i] = -INFINITE;
        }
        search.late.seen.take(data, image);
        search.arrived.count = 0;
        if (seen.m >= 3) data.rounds[image] = climb_all(data, image, NEGLIGIBLE + LAPLACE, search);
        for (long i = 0; i < search.arrived.count; ++i) weigh(data, search, i, modes.modes[i]);
        const long kept = rank(modes, search.arrived.count);
        if (kept)
            combine(data, image, seen, modes, kept, space, mean);
        else
            fail(data, image);
    }
}

const Exported<find_posterior> find_posterior_exported{"find_posterior"};

}  // namespace shapefit
