// The likelihood of an image under Gaussians over shapes and known views, one Gaussian
// a lane.
//
// In the unit of shapes the landmarks y = w / s are jointly Gaussian,
//
//     y ~ N(A mu, S),         S = S_0 + TAU^2 1 1^T,
//     S_0 = A C A^T + N / q,  N_j = v_j + V_j / s^2,
//
// where A_j = P_j R projects landmark j along its own ray, P_j = [I | -slope_j] (weak
// perspective: A_j = R_2), and the translation is integrated out under a wide prior.
// With alpha = S^-1 (y - A mu) the expected shape is X = R mu + R C A^T alpha. The log
// likelihood of the m seen landmarks w is that of y less (2 m - 2) log s. Derivatives
// are over theta: R <- exp([theta_1..3]_x) R, s <- exp(theta_4) s.
//
// q_j is the probability that landmark j is an inlier. Outliers are uniform with the
// density u per area of landmarks, u s^2 in the unit of shapes. With the prior
// probability g of an outlier the value is the variational bound, u for u s^2,
//
//     log N(y; A mu, S) + sum_j (1 - q_j) (log 2 pi |N_j|^1/2 + log g u)
//                         + q_j log(1 - g)
//                         - (1 + q_j) log q_j - (1 - q_j) log(1 - q_j),
//
// and a landmark is an inlier by the odds of its expected Gaussian density beside g u.
#pragma once

#include "../base/lane_triangles.hpp"
#include "../base/registry.hpp"
#include "../pose/rotation.hpp"

namespace shapefit {

// w_j = s (P_j R x_j + t) + noise, x ~ sum_k pi_k N(mu_k, C_k), for n images and K
// components, with P_j = [I | -slope_j], along the ray on which landmark j lies.
struct PosteriorData {
    Arguments& from;
    Tensor<const double> landmarks = from("landmarks", "n 2 p");  // w
    // of the rays: x and y per depth z; 0 = weak perspective
    Tensor<const double> slopes = from("slopes", "n 2 p");
    // v, variance in the unit of shapes, inf = hidden
    Matrix<const double> residual_variance = from("residual_variance", "n p");
    // V, covariance in the unit of the landmarks
    Blocks<const double> noise = from("noise", "n p 2 2");
    Vector<const double> log_weights = from("log_weights", "K");        // log pi
    Tensor<const double> means = from("means", "K 3 p");                // mu
    Tensor<const double> covariances = from("covariances", "K 3p 3p");  // C
    // nan where there are fewer
    Blocks<const double> starts = from("starts", "n S 3 3");
    // Landmarks at both ends of each limb whose usual length is known, log k and Q.
    Matrix<const int64_t> limbs = from("limbs", "e 2");
    Vector<const double> limb_log_length = from("limb_log_length", "e");
    Matrix<const double> limb_precision = from("limb_precision", "e e");
    double chance = from("chance");    // that a landmark is an outlier
    double density = from("density");  // of outliers, per area in their unit
    // an ascent ends when the log likelihood gains less
    double tolerance = from("tolerance");
    // Mean of y = s (R x + t), mean depth 0, its standard deviations, and its
    // correlations of x with y, x with z and y with z of a landmark, where they are
    // wanted; without them no modes are wanted either, nor are lengths of limbs known.
    Tensor<double> mean = from("mean", "n 3 p?");
    Tensor<double> deviation = from("deviation", "n 3 p?");
    Tensor<double> correlation = from("correlation", "n 3 p?");
    Tensor<double> covariance = from("covariance", "n 3p 3p?");  // where it is wanted
    // that a landmark is an inlier
    Matrix<double> inlier_probability = from("inlier_probability", "n p");
    Tensor<double> rotation = from("rotation", "n 3 3");      // of the most likely mode
    Vector<double> scale = from("scale", "n");                // likewise
    Vector<double> log_evidence = from("log_evidence", "n");  // of the image
    // squared Mahalanobis distance of the landmarks, noise of landmark j over its
    // inlier probability
    Vector<double> squared_mahalanobis = from("squared_mahalanobis", "n");
    // whether an ascent ended on a maximum
    Vector<bool> stationary = from("stationary", "n");
    // steps taken by all ascents together
    Vector<int64_t> rounds = from("rounds", "n");
    // The M most likely modes, where they are wanted.
    // -1 where there are fewer
    Matrix<int64_t> mode_component = from("mode_component", "n M?");
    Blocks<double> mode_rotation = from("mode_rotation", "n M 3 3?");
    Matrix<double> mode_scale = from("mode_scale", "n M?");
    // -inf where there are fewer
    Matrix<double> mode_log_evidence = from("mode_log_evidence", "n M?");
    Blocks<double> mode_mean = from("mode_mean", "n M 3 p?");
    Blocks<double> mode_covariance = from("mode_covariance", "n M 3p 3p?");
    Tensor<double> mode_inlier_probability = from("mode_inlier_probability", "n M p?");
};

// What is found of the likelihood at a view: the next inlier probabilities alone, or
// the gradient too, or the curvature too.
enum class Wanted { INLIERS, GRADIENT, CURVATURE };

constexpr double LOG_TWO_PI = 1.8378770664093453;
constexpr int VIEW = 4;  // numbers of theta
// Variance of the translation in the unit of shapes: wide.
constexpr double TAU_SQUARE = 900;
// Curvature that a prior adds to that of the view, in any direction: none is less
// certain than a radian.
constexpr double CURVATURE_OF_PRIOR = 1;
// So that D^-1 is not lost to rounding beside what N / q takes from it, see
// `predict_density`.
template <class Lanes>
constexpr double MIN_INLIER_PROBABILITY =
    sizeof(Number<Lanes>) < sizeof(double) ? 1e-4 : 1e-6;

// Where row i of a lower triangle begins, i (i + 1) / 2.
inline Index corner(Index i) { return i * (i + 1) / 2; }

// What the lanes of a block stand for: the same m landmarks seen, of an image each, and
// a component.
template <class Lanes>
struct Observed {
    Observed(Workspace& workspace, Index p)
        : w(workspace.zeros<Lanes>(2 * p)),
          slope(workspace.zeros<Lanes>(2 * p)),
          residual_variance(workspace.zeros<Lanes>(p)),
          noise(workspace.zeros<Lanes>(3 * p)),
          mean(workspace.zeros<Lanes>(3 * p)),
          covariance(workspace.zeros<Lanes>(9 * corner(p))) {}

    Index m = 0;
    const Index* index = nullptr;  // (m,) their places among all p landmarks
    Lanes *w, *slope;              // (m, 2)
    Lanes* residual_variance;      // v (m,)
    Lanes* noise;                  // V (m, 3): xx, xy, yy
    Lanes* mean;                   // mu (m, 3)
    Lanes* covariance;             // C_jk (3, 3) for k <= j, at 9 (corner(j) + k)
};

// A view, rotation and log s, in each lane.
template <class Lanes>
struct LaneView {
    RotationOf<Lanes> R;
    Lanes log_scale;
};

// The log likelihood at a view and its derivatives over theta.
template <class Lanes>
struct Likelihood {
    Lanes value;
    Lanes gradient[VIEW];          // of -value
    Lanes curvature[VIEW * VIEW];  // Gauss and Newton's
    Lanes squared_mahalanobis;     // (y - A mu)^T S^-1 (y - A mu)
};

// Rows of 2 m numbers are padded to n, a multiple of TILE.
template <class Lanes>
struct LikelihoodSpace {
    LikelihoodSpace(Workspace& workspace, Index n) : workspace(workspace), n(n) {}

    Workspace& workspace;
    const Index n;

    Triangle<Lanes> L{
        allocate(Triangle<Lanes>::size(n))};  // S_0, its Cholesky factor L, then L^-1
    Lanes* reciprocal = allocate(n);          // 1 / L_ii (2 m,)
    Lanes* y = allocate(n);                   // (2 m,)
    // r and S^-1 r, then 1 along x and y and S_0^-1 of it (3, 2 m)
    Lanes *r = allocate(3 * n), *alpha = allocate(3 * n);
    Lanes* white = allocate(VIEW * n);  // L^-1 of r or of J (4, 2 m)
    Lanes* BG = allocate(2 * n);        // (2, 2 m), see Translation
    Lanes *mean = allocate(3 * n / 2), *X = allocate(3 * n / 2);  // R mu and X (m, 3)
    Lanes* A = allocate(3 * n);                                   // (m, 2, 3)
    Lanes* F =
        allocate(n * n / 2);        // z^T R C A^T, of depths with what is seen (m, 2 m)
    Lanes* D = allocate(n);         // sum_k F_jk S^-1_kj (m, 2)
    Lanes* J = allocate(VIEW * n);  // (VIEW, 2 m) of r, then L^-1 of them
    Lanes* diagonal = allocate(3 * n / 2);  // S^-1_jj (m, 3)

  private:
    Lanes* allocate(Index count) { return workspace.zeros<Lanes>(count); }
};

// N_j = v + V / s^2 as xx, xy, yy.
template <class Lanes>
struct Noise {
    Lanes xx, xy, yy;
};

// The noise of landmark j at the scale s, shrunk = 1 / s^2.
template <class Lanes>
[[gnu::always_inline]] inline Noise<Lanes> noise_of(const Observed<Lanes>& observed,
                                                    Index j, Lanes shrunk) {
    const Lanes* V = observed.noise + 3 * j;
    return {observed.residual_variance[j] + V[0] * shrunk, V[1] * shrunk,
            observed.residual_variance[j] + V[2] * shrunk};
}

// Set A, y and the residuals r = y - A mu at a view, and the two columns by which a
// translation changes y; `shrunk` is 1 / s.
template <class Lanes>
void centre(const Observed<Lanes>& observed, const LaneView<Lanes>& view, Lanes shrunk,
            const LikelihoodSpace<Lanes>& space) {
    const Index n = tiled(2 * observed.m);
    for (Index j = 0; j < observed.m; ++j) {
        const Lanes* mu = observed.mean + 3 * j;
        for (int a = 0; a < 3; ++a)
            space.mean[3 * j + a] = view.R[3 * a] * mu[0] + view.R[3 * a + 1] * mu[1] +
                                    view.R[3 * a + 2] * mu[2];
        for (int a = 0; a < 2; ++a) {
            const Lanes slope = observed.slope[2 * j + a];
            for (int c = 0; c < 3; ++c)
                space.A[6 * j + 3 * a + c] = view.R[3 * a + c] - slope * view.R[6 + c];
            space.r[n * (1 + a) + 2 * j + a] = all<Lanes>(1.0);
            space.r[n * (2 - a) + 2 * j + a] = Lanes{};
            space.y[2 * j + a] = observed.w[2 * j + a] * shrunk;
            space.r[2 * j + a] = space.y[2 * j + a] - space.mean[3 * j + a] +
                                 slope * space.mean[3 * j + 2];
        }
    }
}

// Fill the lower triangle of S_0, and the covariances F_jk = z^T R C_jk A_k^T of the
// depth of landmark j with the projection of landmark k; `shrunk` is 1 / s^2.
template <class Lanes>
void fill_covariance(const Observed<Lanes>& observed, const LaneView<Lanes>& view,
                     Lanes shrunk, const Lanes* inlier_probability,
                     const LikelihoodSpace<Lanes>& space) {
    const Index n = tiled(2 * observed.m);
    const Lanes* z = view.R + 6;
    for (Index j = 0; j < observed.m; ++j) {
        Lanes *upper = space.L[2 * j], *lower = space.L[2 * j + 1];
        Lanes Aj[6];
        for (int e = 0; e < 6; ++e) Aj[e] = space.A[6 * j + e];
        for (Index k = 0; k <= j; ++k) {
            const Lanes *C = observed.covariance + 9 * (corner(j) + k),
                        *A = space.A + 6 * k;
            Lanes T[9];  // A_j C_jk, then z^T R C_jk
            for (int c = 0; c < 3; ++c) {
                T[c] = Aj[0] * C[c] + Aj[1] * C[3 + c] + Aj[2] * C[6 + c];
                T[3 + c] = Aj[3] * C[c] + Aj[4] * C[3 + c] + Aj[5] * C[6 + c];
                T[6 + c] = z[0] * C[c] + z[1] * C[3 + c] + z[2] * C[6 + c];
            }
            const Lanes last = T[3] * A[3] + T[4] * A[4] + T[5] * A[5];
            upper[2 * k] = T[0] * A[0] + T[1] * A[1] + T[2] * A[2];
            lower[2 * k] = T[3] * A[0] + T[4] * A[1] + T[5] * A[2];
            lower[2 * k + 1] = last;
            if (k < j) upper[2 * k + 1] = T[0] * A[3] + T[1] * A[4] + T[2] * A[5];
            Lanes *Fj = space.F + j * n + 2 * k, *Fk = space.F + k * n + 2 * j;
            Fk[0] = T[0] * z[0] + T[1] * z[1] + T[2] * z[2];
            Fk[1] = T[3] * z[0] + T[4] * z[1] + T[5] * z[2];
            Fj[0] = T[6] * A[0] + T[7] * A[1] + T[8] * A[2];
            Fj[1] = T[6] * A[3] + T[7] * A[4] + T[8] * A[5];
        }
        const Noise<Lanes> N = noise_of(observed, j, shrunk);
        const Lanes share = 1.0 / inlier_probability[j];
        upper[2 * j] += N.xx * share;
        lower[2 * j] += N.xy * share;
        lower[2 * j + 1] += N.yy * share;
    }
    // beyond what is seen: the identity, and nothing that goes with it
    for (Index e = 2 * observed.m; e < n; ++e) {
        for (Index k = 0; k <= e; ++k) space.L[e][k] = all<Lanes>(k == e ? 1.0 : 0.0);
        for (Index j = 0; j < n / 2; ++j) space.F[j * n + e] = Lanes{};
        for (Index j = 0; j < n; ++j) space.F[e / 2 * n + j] = Lanes{};
        for (int a = 0; a < 3; ++a) space.r[a * n + e] = Lanes{};
        for (int i = 0; i < VIEW; ++i) space.J[i * n + e] = Lanes{};
    }
}

// The translation t ~ N(0, TAU^2 I); with B = S_0^-1 1
//
//     G = (1^T B + I / TAU^2)^-1,   E[t] = G 1^T S_0^-1 r,   S^-1 = S_0^-1 - B G B^T
template <class Lanes>
struct Translation {
    Lanes xx, xy, yy;       // G
    Lanes x, y;             // E[t]
    Lanes square, log_det;  // <r, S^-1 r> and log det S, less those of S_0
};

// Find alpha = S_0^-1 (r - 1 E[t]) = S^-1 r, B and B G, by L^-1 in space.L; returns the
// translation.
template <class Lanes>
Translation<Lanes> solve(Index n, const LikelihoodSpace<Lanes>& space) {
    multiply<3>(n, space.L, space.r, space.white);
    multiply_transposed<3>(n, space.L, space.white, space.alpha);
    Lanes *alpha = space.alpha, *Bx = alpha + n, *By = Bx + n;
    Lanes xx = all<Lanes>(1 / TAU_SQUARE), xy = {}, yy = xx, x = {}, y = {};
    for (Index e = 0; e < n; e += 2) {
        xx += Bx[e];
        xy += By[e];
        yy += By[e + 1];
        x += alpha[e];
        y += alpha[e + 1];
    }
    const Lanes det = xx * yy - xy * xy, scale = 1.0 / det;
    Translation<Lanes> t{yy * scale,
                         -xy * scale,
                         xx * scale,
                         {},
                         {},
                         {},
                         logarithm(det * all<Lanes>(square(TAU_SQUARE)))};
    t.x = t.xx * x + t.xy * y;
    t.y = t.xy * x + t.yy * y;
    t.square = -(x * t.x + y * t.y);
    for (Index e = 0; e < n; ++e) {
        alpha[e] -= Bx[e] * t.x + By[e] * t.y;
        space.BG[e] = Bx[e] * t.xx + By[e] * t.xy;
        space.BG[n + e] = Bx[e] * t.xy + By[e] * t.yy;
    }
    return t;
}

// Find the expected points X = R mu + R C A^T alpha of the visible landmarks: in depth
// by F, and across by P X = y - N alpha - E[t].
template <class Lanes>
void find_expected_points(const Observed<Lanes>& observed, Lanes shrunk,
                          const Lanes* inlier_probability, const Translation<Lanes>& t,
                          const LikelihoodSpace<Lanes>& space) {
    const Index N = 2 * observed.m, n = tiled(N);
    for (Index j = 0; j < observed.m; ++j) {
        const Lanes *F = space.F + j * n, *alpha = space.alpha + 2 * j,
                    *y = space.y + 2 * j;
        const Noise<Lanes> noise = noise_of(observed, j, shrunk);
        const Lanes share = 1.0 / inlier_probability[j];
        Lanes z = space.mean[3 * j + 2];
        for (Index e = 0; e < N; ++e) z += F[e] * space.alpha[e];
        Lanes* X = space.X + 3 * j;
        X[0] = y[0] - (noise.xx * alpha[0] + noise.xy * alpha[1]) * share - t.x +
               observed.slope[2 * j] * z;
        X[1] = y[1] - (noise.xy * alpha[0] + noise.yy * alpha[1]) * share - t.y +
               observed.slope[2 * j + 1] * z;
        X[2] = z;
    }
}

// Find the blocks S^-1_jj (2, 2) on the diagonal of S^-1 and, unless they are wanted
// `alone`, D_j = sum_k F_jk S^-1_kj (m, 2).
template <class Lanes>
void find_inverse_blocks(const Observed<Lanes>& observed, bool alone,
                         const LikelihoodSpace<Lanes>& space) {
    const Index N = 2 * observed.m, n = tiled(N);
    for (Index e = 0; e < n; ++e) space.D[e] = Lanes{};
    for (Index j = 0; j < n; j += TILE)
        for (Index k = alone ? j : 0; k <= j; k += TILE) {
            Lanes inverse[TILE][TILE] = {};  // a tile of S_0^-1
            add_products(
                inverse, j, n, [&](Index i, int r) { return space.L[i][j + r]; },
                [&](Index i, int c) { return space.L[i][k + c]; });
            for (int r = 0; r < TILE; ++r)
                for (int c = 0; c < TILE; ++c) {
                    space.D[j + r] += inverse[r][c] * space.F[(j + r) / 2 * n + k + c];
                    if (k < j)
                        space.D[k + c] +=
                            inverse[r][c] * space.F[(k + c) / 2 * n + j + r];
                }
            for (int r = 0; j == k && r < TILE; r += 2) {
                Lanes* diagonal = space.diagonal + 3 * ((j + r) / 2);
                diagonal[0] = inverse[r][r];
                diagonal[1] = inverse[r + 1][r];
                diagonal[2] = inverse[r + 1][r + 1];
            }
        }
    const Lanes *Bx = space.alpha + n, *By = Bx + n, *Gx = space.BG, *Gy = Gx + n;
    for (Index j = 0; j < observed.m; ++j) {
        const Lanes* F = space.F + j * n;
        Lanes x = {}, y = {};
        for (Index e = 0; e < N; ++e) {
            x += F[e] * Bx[e];
            y += F[e] * By[e];
        }
        const Index e = 2 * j;
        space.D[e] -= x * Gx[e] + y * Gy[e];
        space.D[e + 1] -= x * Gx[e + 1] + y * Gy[e + 1];
        space.diagonal[3 * j] -= Bx[e] * Gx[e] + By[e] * Gy[e];
        space.diagonal[3 * j + 1] -= Bx[e] * Gx[e + 1] + By[e] * Gy[e + 1];
        space.diagonal[3 * j + 2] -= Bx[e + 1] * Gx[e + 1] + By[e + 1] * Gy[e + 1];
    }
}

// Add the derivatives of 1/2 log det S in turns of the camera frame to `gradient`: for
// a turn G sum_j tr(P_j G V_j), where V_j (3, 2), the rows of sum_k R C_jk A_k^T
// S^-1_kj, is D_j in depth, and P_j V_j = I - N_j S^-1_jj - (B G)_j.
template <class Lanes>
void add_determinant_gradient(const Observed<Lanes>& observed, Lanes shrunk,
                              const Lanes* inlier_probability,
                              const LikelihoodSpace<Lanes>& space, Lanes* gradient) {
    const Lanes* BG = space.BG;
    const Index n = tiled(2 * observed.m);
    for (Index j = 0; j < observed.m; ++j) {
        const Lanes *I = space.diagonal + 3 * j, *D = space.D + 2 * j;
        const Lanes* u = observed.slope + 2 * j;
        const Noise<Lanes> noise = noise_of(observed, j, shrunk);
        const Lanes share = 1.0 / inlier_probability[j];
        Lanes V[2][2];
        for (int b = 0; b < 2; ++b) {
            const Lanes column[2] = {I[b], I[1 + b]};
            V[0][b] = u[0] * D[b] - BG[2 * j + b] -
                      (noise.xx * column[0] + noise.xy * column[1]) * share;
            V[1][b] = u[1] * D[b] - BG[n + 2 * j + b] -
                      (noise.xy * column[0] + noise.yy * column[1]) * share;
            V[b][b] += 1.0;
        }
        gradient[0] -= D[1] + u[0] * V[1][0] + u[1] * V[1][1];
        gradient[1] += D[0] + u[0] * V[0][0] + u[1] * V[0][1];
        gradient[2] += V[0][1] - V[1][0];
    }
}

// Set J to the derivatives of r over theta: -P_j G_i X for the turns, -y for log s.
template <class Lanes>
void linearise(const Observed<Lanes>& observed, const LikelihoodSpace<Lanes>& space) {
    const Index n = tiled(2 * observed.m);
    for (Index j = 0; j < observed.m; ++j) {
        const Lanes* X = space.X + 3 * j;
        Lanes* J = space.J + 2 * j;
        const Lanes* slope = observed.slope + 2 * j;
        J[0] = slope[0] * X[1];
        J[1] = X[2] + slope[1] * X[1];
        J[n] = -X[2] - slope[0] * X[0];
        J[n + 1] = -slope[1] * X[0];
        J[2 * n] = X[1];
        J[2 * n + 1] = -X[0];
        J[3 * n] = -space.y[2 * j];
        J[3 * n + 1] = -space.y[2 * j + 1];
    }
}

// Find the gradient of the negative log likelihood over theta and, where `curved`, its
// Gauss-Newton curvature.
template <class Lanes>
void differentiate(const Observed<Lanes>& observed, Lanes shrunk,
                   const Lanes* inlier_probability, const Translation<Lanes>& t,
                   bool curved, const LikelihoodSpace<Lanes>& space,
                   Likelihood<Lanes>& found) {
    const Index N = 2 * observed.m, n = tiled(N);
    linearise(observed, space);
    for (int i = 0; i < VIEW; ++i) {
        Lanes total = {};
        for (Index e = 0; e < N; ++e) total += space.J[i * n + e] * space.alpha[e];
        found.gradient[i] = total;
    }
    add_determinant_gradient(observed, shrunk, inlier_probability, space,
                             found.gradient);
    found.gradient[3] += static_cast<Number<Lanes>>(N - 2);
    for (Index j = 0; j < observed.m; ++j) {
        const Lanes *V = observed.noise + 3 * j, *alpha = space.alpha + 2 * j,
                    *D = space.diagonal + 3 * j;
        const Noise<Lanes> noise = noise_of(observed, j, shrunk);
        const Lanes q = inlier_probability[j],
                    det = noise.xx * noise.yy - noise.xy * noise.xy;
        found.gradient[3] +=
            shrunk *
            ((V[0] * (alpha[0] * alpha[0] - D[0]) +
              V[2] * (alpha[1] * alpha[1] - D[2]) +
              2.0 * V[1] * (alpha[0] * alpha[1] - D[1])) /
                 q +
             (1.0 - q) * (V[0] * noise.yy + V[2] * noise.xx - 2.0 * V[1] * noise.xy) /
                 det);
    }
    if (!curved) return;
    multiply<VIEW>(n, space.L, space.J, space.white);
    Lanes along[VIEW][2] = {};  // J B
    for (int i = 0; i < VIEW; ++i)
        for (Index e = 0; e < N; ++e)
            for (int a = 0; a < 2; ++a)
                along[i][a] += space.J[i * n + e] * space.alpha[(1 + a) * n + e];
    for (int i = 0; i < VIEW; ++i)
        for (int j = 0; j <= i; ++j) {
            Lanes total = -along[i][0] * (t.xx * along[j][0] + t.xy * along[j][1]) -
                          along[i][1] * (t.xy * along[j][0] + t.yy * along[j][1]);
            for (Index e = 0; e < n; ++e)
                total += space.white[i * n + e] * space.white[j * n + e];
            found.curvature[VIEW * i + j] = found.curvature[VIEW * j + i] = total;
        }
}

// The log density of a landmark as the other landmarks predict it, log N(r; 0, P): with
// D = S^-1_jj and a = alpha_j it is off by r = D^-1 a, with the covariance P = D^-1 - N
// / q
// + N.
template <class Lanes>
Lanes predict_density(const Noise<Lanes>& N, Lanes q, const Lanes* a, const Lanes* D) {
    const Lanes scale = 1.0 / (D[0] * D[2] - D[1] * D[1]);
    const Lanes rx = (D[2] * a[0] - D[1] * a[1]) * scale,
                ry = (D[0] * a[1] - D[1] * a[0]) * scale;
    const Lanes less = 1.0 - 1.0 / q;
    const Lanes xx = D[2] * scale + N.xx * less, yy = D[0] * scale + N.yy * less;
    const Lanes xy = -D[1] * scale + N.xy * less;
    const Lanes det = larger(xx * yy - xy * xy, all<Lanes>(1e-12));
    return -0.5 * ((yy * rx * rx - 2.0 * xy * rx * ry + xx * ry * ry) / det +
                   logarithm(det)) -
           all<Lanes>(LOG_TWO_PI);
}

// Find the next inlier probabilities q_j = 1 / (1 + exp(-log odds)), from the other
// landmarks alone where `by_others`; add the terms of the present ones to the gradient
// over log s and, where `valued`, to the value.
template <class Lanes>
void update_inliers(const PosteriorData& data, const Observed<Lanes>& observed,
                    const LaneView<Lanes>& view, Lanes shrunk,
                    const Lanes* inlier_probability, bool by_others, bool valued,
                    const LikelihoodSpace<Lanes>& space, Likelihood<Lanes>& found,
                    Lanes* next) {
    if (!(data.chance > 0)) {
        for (Index j = 0; j < observed.m; ++j) next[j] = all<Lanes>(1.0);
        return;
    }
    const Number<Lanes> log_inlier = log1p(-data.chance);
    const Lanes outlier =
        all<Lanes>(log(data.chance * data.density)) + 2.0 * view.log_scale;
    for (Index j = 0; j < observed.m; ++j) {
        const Noise<Lanes> N = noise_of(observed, j, shrunk);
        const Lanes q = inlier_probability[j], rest = 1.0 - q;
        found.gradient[3] -= 2.0 * rest;
        const Lanes log_size =
            0.5 * logarithm(N.xx * N.yy - N.xy * N.xy) + all<Lanes>(LOG_TWO_PI);
        const Lanes *a = space.alpha + 2 * j, *D = space.diagonal + 3 * j;
        const Lanes square = N.xx * (a[0] * a[0] - D[0]) +
                             2.0 * N.xy * (a[0] * a[1] - D[1]) +
                             N.yy * (a[1] * a[1] - D[2]);
        const Lanes expected = square / (q * q) + 2.0 / q;
        const Lanes density =
            by_others ? predict_density(N, q, a, D) : -log_size - 0.5 * expected;
        const Lanes odds = log_inlier + density - outlier;
        const Lanes steep = larger(smaller(odds, all<Lanes>(40.0)), all<Lanes>(-40.0));
        next[j] = larger(1.0 / (1.0 + exponential(-steep)),
                         all<Lanes>(MIN_INLIER_PROBABILITY<Lanes>));
        if (!valued) continue;
        found.value += rest * (log_size + outlier) + q * log_inlier -
                       (1.0 + q) * logarithm(q) -
                       rest * logarithm(rest + all<Lanes>(1e-30));
    }
}

// Find what is wanted of the log likelihood at a view with the inlier probabilities q
// (m,), and set next (m,) to the next ones of the fixed-point iteration; or, where
// `by_others`, to those that the other landmarks alone give each, which an outlier
// cannot sway.
template <class Lanes>
void find_likelihood(const PosteriorData& data, const Observed<Lanes>& observed,
                     const LaneView<Lanes>& view, const Lanes* inlier_probability,
                     bool by_others, Wanted wanted, const LikelihoodSpace<Lanes>& space,
                     Likelihood<Lanes>& found, Lanes* next) {
    const Index N = 2 * observed.m, n = tiled(N);
    const Lanes shrink = exponential(-view.log_scale);
    centre(observed, view, shrink, space);
    fill_covariance(observed, view, shrink * shrink, inlier_probability, space);
    const Lanes log_det = factorise(n, space.L, space.reciprocal);
    invert(n, space.L, space.reciprocal);
    const Translation<Lanes> t = solve(n, space);
    found.squared_mahalanobis = t.square;
    for (Index e = 0; e < n; ++e)
        found.squared_mahalanobis += space.white[e] * space.white[e];
    found.value = -0.5 * (found.squared_mahalanobis + log_det + t.log_det +
                          all<Lanes>(static_cast<double>(N) * LOG_TWO_PI)) -
                  static_cast<Number<Lanes>>(N - 2) * view.log_scale;
    const bool derived = wanted != Wanted::INLIERS,
               curved = wanted == Wanted::CURVATURE;
    find_inverse_blocks(observed, !derived, space);
    if (derived) {
        find_expected_points(observed, shrink * shrink, inlier_probability, t, space);
        differentiate(observed, shrink * shrink, inlier_probability, t, curved, space,
                      found);
    }
    update_inliers(data, observed, view, shrink * shrink, inlier_probability, by_others,
                   derived, space, found, next);
}

}  // namespace shapefit
