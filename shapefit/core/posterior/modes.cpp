#include "modes.hpp"

#include "../base/vectors.hpp"
#include "../base/small_matrices.hpp"

namespace shapefit {
namespace {

// (R x I) x for x (3, p).
void turn(const double* R, const double* x, long p, double* __restrict out) {
    for (int a = 0; a < 3; ++a)
        for (long j = 0; j < p; ++j)
            out[a * p + j] = R[3 * a] * x[j] + R[3 * a + 1] * x[p + j] + R[3 * a + 2] * x[2 * p + j];
}

// C <- (R x I) C (R x I)^T
void turn_covariance(const double* R, const double* given, long p, ModeSpace& space) {
    const long d = 3 * p, D = padded(d);
    for (long i = 0; i < d; ++i) turn(R, given + i * d, p, space.C[i].data);
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
double look(const Observed<double>& seen, long i, const double* x, long p) {
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
            space.S[i * n + k] = i < N && k < N ? look(seen, k, space.K[i].data, p) : i == k ? 1.0 : 0.0;
    for (long j = 0; j < seen.m; ++j) {
        const double *V = seen.noise + 3 * j, share = 1 / mode.belief[j];
        double* at = space.S + 2 * j * (n + 1);
        at[0] += (seen.misfit[j] + V[0] / (s * s)) * share;
        at[1] += V[1] / (s * s) * share;
        at[n + 1] += (seen.misfit[j] + V[2] / (s * s)) * share;
    }
    factorise_block(space.S, space.V, n, n);
    for (long i = 0; i < n; ++i)
        space.alpha[i] = i < N ? space.y[i] - look(seen, i, space.mean.data, p) : 0.0;
}

// x <- S^-1 x for n numbers, zeros after those seen.
void solve(ModeSpace& space, long n, double* x) {
    for (long i = 0; i < n; ++i) space.white[i] = dot_padded(space.V + i * n, x, n);
    mix_rows(space.white.data, n, space.V, n, n, x);
}

// out = G_i x for x (3, p), G_i the turn about axis i; transposed: G_i^T x = -G_i x.
void generate(int axis, const double* x, long p, double* __restrict out) {
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
            generate(i, raised, p, spun);
            mix_rows(spun, d, space.C.data, D, D, J);
            generate(i, space.X.data, p, spun);
            for (long e = 0; e < d; ++e) J[e] = spun[e] - J[e];
            for (long e = 0; e < N; ++e) change[e] = -look(seen, e, J, p);
        } else {
            for (long j = 0; j < seen.m; ++j) {
                const double *V = seen.noise + 3 * j, *alpha = space.alpha.data + 2 * j;
                const double share = 2 / (s * s * mode.belief[j]);
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

}  // namespace

ModeSpace::ModeSpace(Workspace& workspace, long p)
    : p(p),
      C(workspace.matrix<double>(padded(3 * p), padded(3 * p))),
      K(workspace.matrix<double>(padded(2 * p), padded(3 * p))),
      U(workspace.matrix<double>(padded(2 * p), padded(3 * p))),
      J(workspace.matrix<double>(VIEW, padded(3 * p))),
      S(workspace.zeros<double>(padded(2 * p) * padded(2 * p))),
      V(workspace.zeros<double>(padded(2 * p) * padded(2 * p))),
      y(workspace.vector<double>(padded(2 * p))),
      alpha(workspace.vector<double>(padded(2 * p))),
      white(workspace.vector<double>(padded(2 * p))),
      change(workspace.vector<double>(padded(2 * p))),
      mean(workspace.vector<double>(padded(3 * p))),
      X(workspace.vector<double>(padded(3 * p))),
      turned(workspace.vector<double>(2 * padded(3 * p))) {}

void describe(const PosteriorData& data, const Observed<double>& seen, const Mode& mode, ModeSpace& space,
              bool whole, double* mean) {
    const long p = data.landmarks.size[2], d = 3 * p, D = padded(d), N = 2 * seen.m, n = padded(N);
    const double s = exp(mode.log_scale);
    turn_covariance(mode.R, data.covariances[mode.component].data, p, space);
    turn(mode.R, data.means[mode.component].data, p, space.mean.data);
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
            space.C[e][f] = s * s * (space.C[e][f] + (e < 2 * p && e / p == f / p ? TAU_SQUARE : 0.0));
    centre_covariance(space, p);
    for (long i = 0; i < N; ++i) centre_depth(space.U[i].data, p);
    for (int i = 0; i < VIEW; ++i) centre_depth(space.J[i].data, p);
    add_squares(-1, space.U, N, whole, space);
    add_squares(1, space.J, VIEW, whole, space);
}

}  // namespace shapefit
