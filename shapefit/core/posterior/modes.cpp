#include "modes.hpp"

#include "../algebra/vectors.hpp"

namespace shapefit::SHAPEFIT_LEVEL {
namespace {

// (R x I) x for x (3, p).
void turn(const double* R, const double* x, long p, double* __restrict out) {
    for (int a = 0; a < 3; ++a)
        for (long j = 0; j < p; ++j)
            out[a * p + j] = R[3 * a] * x[j] + R[3 * a + 1] * x[p + j] + R[3 * a + 2] * x[2 * p + j];
}

// C <- (R x I) C (R x I)^T
void turn_covariance(const double* R, const double* given, long p, ModeSpace& space) {
    const long d = 3 * p;
    for (long i = 0; i < d; ++i) turn(R, given + i * d, p, space.C.data + i * d);
    for (long j = 0; j < p; ++j) {
        double *x = space.C.data + j * d, *y = x + p * d, *z = y + p * d;
        for (long e = 0; e < d; ++e) {
            const double cx = x[e], cy = y[e], cz = z[e];
            x[e] = R[0] * cx + R[1] * cy + R[2] * cz;
            y[e] = R[3] * cx + R[4] * cy + R[5] * cz;
            z[e] = R[6] * cx + R[7] * cy + R[8] * cz;
        }
    }
}

void factorise(Matrix<double> L, long N) {
    const long stride = L.size[1];
    for (long i = 0; i < N; ++i)
        for (long j = 0; j <= i; ++j) {
            double* row = L.data + i * stride;
            double rest = row[j] - dot(row, L.data + j * stride, j);
            row[j] = i == j ? root(larger(rest, 1e-12)) : rest / L.data[j * stride + j];
        }
}

// x <- S^-1 x
void solve(Matrix<double> L, long N, double* x) {
    const long stride = L.size[1];
    for (long i = 0; i < N; ++i)
        x[i] = (x[i] - dot(L.data + i * stride, x, i)) / L.data[i * stride + i];
    for (long i = N - 1; i >= 0; --i) {
        x[i] /= L.data[i * stride + i];
        for (long j = 0; j < i; ++j) x[j] -= L.data[i * stride + j] * x[i];
    }
}

// out += sum_i x_i (C P^T)_i, and the translation of x on the first two coordinates.
void pull(const ModeSpace& space, long m, long p, const double* x, double* out) {
    double t[2] = {};
    for (long j = 0; j < m; ++j)
        for (int a = 0; a < 2; ++a) {
            add_to(out, x[2 * j + a], space.K.data + (2 * j + a) * 3 * p, 3 * p);
            t[a] += TAU_SQUARE * x[2 * j + a];
        }
    for (int a = 0; a < 2; ++a)
        for (long j = 0; j < p; ++j) out[a * p + j] += t[a];
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
// A turn G: dX = G X + C G^T P^T alpha + C P^T d(alpha), d(alpha) = -S^-1 P (G X + C G^T P^T alpha);
// log s: d(alpha) = S^-1 (-y + 2 V / (s^2 q) alpha).
void differentiate(const Observed& seen, const Mode& mode, double s, const double* y, ModeSpace& space,
                   const double* shape) {
    const long m = seen.m, p = space.X.size[0] / 3, d = 3 * p;
    for (int i = 0; i < VIEW; ++i) {
        double* J = space.J[i].data;
        for (long e = 0; e < d; ++e) J[e] = 0;
        double* change = space.pull.data;
        if (i < 3) {
            double* raised = space.turned.data;  // P^T alpha, then C G^T P^T alpha
            for (long e = 0; e < d; ++e) raised[e] = 0;
            for (long j = 0; j < m; ++j)
                for (int a = 0; a < 2; ++a) {
                    raised[a * p + seen.index[j]] = space.alpha[2 * j + a];
                    raised[2 * p + seen.index[j]] -= seen.slope[2 * j + a] * space.alpha[2 * j + a];
                }
            double* spun = raised + d;
            generate(i, raised, p, spun);
            generate(i, space.X.data, p, J);
            for (long e = 0; e < d; ++e)
                if (spun[e] != 0) add_to(J, -spun[e], space.C.data + e * d, d);
            for (long j = 0; j < m; ++j)
                for (int a = 0; a < 2; ++a)
                    change[2 * j + a] = seen.slope[2 * j + a] * J[2 * p + seen.index[j]] -
                                        J[a * p + seen.index[j]];
        } else {
            for (long j = 0; j < m; ++j) {
                const double *V = seen.noise + 3 * j, *alpha = space.alpha.data + 2 * j;
                const double share = 2 / (s * s * mode.belief[j]);
                change[2 * j] = -y[2 * j] + share * (V[0] * alpha[0] + V[1] * alpha[1]);
                change[2 * j + 1] = -y[2 * j + 1] + share * (V[1] * alpha[0] + V[2] * alpha[1]);
            }
        }
        solve(space.L, 2 * m, change);
        pull(space, m, p, change, J);
        for (long e = 0; e < d; ++e) J[e] = s * J[e] + (i == 3 ? shape[e] : 0.0);
    }
}

// covariance += J^T H^-1 J
void add_view(const Mode& mode, long d, ModeSpace& space, double* covariance) {
    double L[VIEW][VIEW];
    for (int i = 0; i < VIEW; ++i)
        for (int j = 0; j <= i; ++j) {
            double rest = mode.hessian[VIEW * i + j];
            for (int k = 0; k < j; ++k) rest -= L[i][k] * L[j][k];
            L[i][j] = i == j ? root(larger(rest, LEAST_CURVATURE)) : rest / L[j][j];
        }
    for (int i = 0; i < VIEW; ++i) {
        double* row = space.J[i].data;
        for (int k = 0; k < i; ++k) add_to(row, -L[i][k], space.J[k].data, d);
        for (long e = 0; e < d; ++e) row[e] /= L[i][i];
    }
    for (long e = 0; e < d; ++e)
        for (int i = 0; i < VIEW; ++i) add_to(covariance + e * d, space.J[i][e], space.J[i].data, d);
}

// Take the mean depth out of a vector.
void centre_depth(double* x, long p) {
    double mean = 0;
    for (long j = 0; j < p; ++j) mean += x[2 * p + j];
    for (long j = 0; j < p; ++j) x[2 * p + j] -= mean / static_cast<double>(p);
}

void centre_covariance(double* covariance, long p) {
    const long d = 3 * p;
    for (long e = 0; e < d; ++e) centre_depth(covariance + e * d, p);
    double* mean = covariance + 2 * p * d;
    for (long e = 0; e < d; ++e) {
        double total = 0;
        for (long j = 0; j < p; ++j) total += mean[j * d + e];
        for (long j = 0; j < p; ++j) mean[j * d + e] -= total / static_cast<double>(p);
    }
}

}  // namespace

ModeSpace::ModeSpace(Workspace& workspace, long p)
    : C(workspace.matrix<double>(3 * p, 3 * p)),
      U(workspace.matrix<double>(2 * p, 3 * p)),
      K(workspace.matrix<double>(2 * p, 3 * p)),
      L(workspace.matrix<double>(2 * p, 2 * p)),
      alpha(workspace.vector<double>(2 * p)),
      mean(workspace.vector<double>(3 * p)),
      X(workspace.vector<double>(3 * p)),
      pull(workspace.vector<double>(2 * p)),
      turned(workspace.vector<double>(6 * p)),
      J(workspace.matrix<double>(VIEW, 3 * p)) {}

void describe(const PosteriorData& data, const Observed& seen, const Mode& mode, ModeSpace& space,
              double* mean, double* covariance) {
    const long p = data.landmarks.size[2], d = 3 * p, m = seen.m, N = 2 * m;
    const double s = exp(mode.log_scale);
    turn_covariance(mode.R, data.covariances[mode.component].data, p, space);
    turn(mode.R, data.means[mode.component].data, p, space.mean.data);
    for (long j = 0; j < m; ++j)
        for (int a = 0; a < 2; ++a) {
            const double* row = space.C.data + (a * p + seen.index[j]) * d;
            double* to = space.K.data + (2 * j + a) * d;
            for (long e = 0; e < d; ++e) to[e] = row[e];
            const double* depth = space.C.data + (2 * p + seen.index[j]) * d;
            add_to(to, -seen.slope[2 * j + a], depth, d);
        }
    for (long j = 0; j < m; ++j) {
        const double* V = seen.noise + 3 * j;
        const double q = mode.belief[j], v = seen.misfit[j];
        for (int a = 0; a < 2; ++a) {
            double* row = space.L.data + (2 * j + a) * space.L.size[1];
            const double* K = space.K.data + (2 * j + a) * d;
            for (long k = 0; k <= j; ++k)
                for (int b = 0; b < 2; ++b)
                    row[2 * k + b] = K[b * p + seen.index[k]] -
                                     seen.slope[2 * k + b] * K[2 * p + seen.index[k]] +
                                     (a == b ? TAU_SQUARE : 0.0);
            row[2 * j + a] += (v + V[2 * a] / (s * s)) / q;
            if (a == 1) row[2 * j] += V[1] / (s * s) / q;
            space.alpha[2 * j + a] = seen.w[2 * j + a] / s - space.mean[a * p + seen.index[j]] +
                                     seen.slope[2 * j + a] * space.mean[2 * p + seen.index[j]];
        }
    }
    factorise(space.L, N);
    solve(space.L, N, space.alpha.data);
    // mean
    for (long e = 0; e < d; ++e) space.X[e] = space.mean[e];
    for (long i = 0; i < N; ++i) add_to(space.X.data, space.alpha[i], space.K.data + i * d, d);
    for (long e = 0; e < d; ++e) mean[e] = space.mean[e];
    pull(space, m, p, space.alpha.data, mean);
    for (long e = 0; e < d; ++e) mean[e] *= s;
    // covariance of s (X + t)
    for (long i = 0; i < N; ++i) {
        double* row = space.U.data + i * d;
        for (long e = 0; e < d; ++e) row[e] = space.K.data[i * d + e];
        for (long j = 0; j < p; ++j) row[(i % 2) * p + j] += TAU_SQUARE;
        for (long k = 0; k < i; ++k) add_to(row, -space.L.data[i * space.L.size[1] + k], space.U.data + k * d, d);
        const double inverse = 1 / space.L.data[i * space.L.size[1] + i];
        for (long e = 0; e < d; ++e) row[e] *= inverse;
    }
    for (long e = 0; e < d; ++e) {
        double* row = covariance + e * d;
        for (long f = 0; f < d; ++f) row[f] = space.C.data[e * d + f];
        if (e < 2 * p)
            for (long j = 0; j < p; ++j) row[e / p * p + j] += TAU_SQUARE;
        for (long i = 0; i < N; ++i) add_to(row, -space.U.data[i * d + e], space.U.data + i * d, d);
        for (long f = 0; f < d; ++f) row[f] *= s * s;
    }
    double* y = space.U.data;  // no longer needed
    for (long i = 0; i < N; ++i) y[i] = seen.w[i] / s;
    differentiate(seen, mode, s, y, space, mean);
    add_view(mode, d, space, covariance);
    centre_depth(mean, p);
    centre_covariance(covariance, p);
}

}  // namespace shapefit::SHAPEFIT_LEVEL
