// The likelihood of an image under Gaussians over shapes and known views, one Gaussian a lane.
//
// In the unit of shapes the landmarks y = w / s are jointly Gaussian,
//
//     y ~ N(A mu, S),   S = S_0 + TAU^2 1 1^T,   S_0 = A C A^T + N / q,   N_j = v_j + V_j / s^2,
//
// where A_j = P_j R projects landmark j along its own ray, P_j = [I | -slope_j] (weak perspective:
// A_j = R_2), and the translation is integrated out under a wide prior. With alpha = S^-1 (y - A mu)
// the expected shape is X = R mu + R C A^T alpha. The log likelihood of the m seen landmarks w is that of y less
// (2 m - 2) log s. Derivatives are over theta: R <- exp([theta_1..3]_x) R, s <- exp(theta_4) s.
//
// q_j is the belief that landmark j is not gross. A gross one is uniform with the density u per area
// of landmarks, u s^2 in the unit of shapes; with the chance g of that the value is the variational
// bound, u for u s^2,
//
//     log N(y; A mu, S) + sum_j (1 - q_j) (log 2 pi |N_j|^1/2 + log g u) + q_j log(1 - g)
//                         - (1 + q_j) log q_j - (1 - q_j) log(1 - q_j),
//
// and a landmark is believed by the odds of its expected Gaussian density beside g u.
#pragma once

#include "../base/lanes.hpp"
#include "../base/memory.hpp"
#include "data.hpp"
#include "../base/lane_triangles.hpp"

namespace shapefit {

constexpr double LOG_TWO_PI = 1.8378770664093453;
constexpr int VIEW = 4;             // numbers of theta
constexpr double TAU_SQUARE = 900;  // variance of the translation in the unit of shapes: wide
// Curvature that a prior adds to that of the view, in any direction: none is less certain than a radian.
constexpr double CURVATURE_OF_PRIOR = 1;
// Beside what N / q takes away from D^-1 the rest must still count, see `predict`.
template <class Lanes>
constexpr double LEAST_BELIEF = sizeof(Number<Lanes>) < sizeof(double) ? 1e-4 : 1e-6;

// Where row i of a lower triangle begins.
inline long corner(long i) { return i * (i + 1) / 2; }

// The m seen landmarks of an image.
template <class Number>
struct Observed {
    long m = 0;
    long* index;     // (p,) their places among all p landmarks
    Number* w;       // (p, 2)
    Number* slope;   // (p, 2)
    Number* misfit;  // v (p,)
    Number* noise;   // V (p, 3): xx, xy, yy
    bool noisy = false;  // whether a V is not 0
};

// The components that the lanes of a block stand for, as far as they are seen.
template <class Lanes>
struct Pack {
    Lanes* mean;        // mu (m, 3)
    Lanes* covariance;  // C_jk (3, 3) for k <= j, at 9 (corner(j) + k)
};

template <class Lanes>
struct LaneView {
    Lanes R[9];
    Lanes log_scale;
};

template <class Lanes>
struct Likelihood {
    Lanes value;
    Lanes gradient[VIEW];          // of -value
    Lanes curvature[VIEW * VIEW];  // Gauss and Newton's
    Lanes surprise;                // (y - A mu)^T S^-1 (y - A mu)
};

// Rows of 2 m numbers are padded to n, a multiple of TILE.
template <class Lanes>
struct LikelihoodSpace {
    LikelihoodSpace(Workspace& workspace, long n);

    Triangle<Lanes> L;          // S_0, its Cholesky factor L, then L^-1 (2 m, 2 m)
    Lanes* reciprocal;   // 1 / L_ii (2 m,)
    Lanes* y;                    // (2 m,)
    Lanes *r, *alpha;            // r and S^-1 r, then 1 along x and y and S_0^-1 of it (3, 2 m)
    Lanes* white;                // L^-1 of r or of J (4, 2 m)
    Lanes* BG;                   // (2, 2 m), see Translation
    Lanes *mean, *X;     // R mu and X (m, 3)
    Lanes* A;            // (m, 2, 3)
    Lanes* F;            // z^T R C A^T, of depths with what is seen (m, 2 m)
    Lanes* D;            // sum_k F_jk S^-1_kj (m, 2)
    Lanes* J;            // (VIEW, 2 m) of r, then L^-1 of them
    Lanes* diagonal;     // S^-1_jj (m, 3)
};

template <class Number>
Observed<Number> room_for_observed(Workspace& workspace, long p);
template <class Number>
void observe(const PosteriorData& data, long image, Observed<Number>& seen);

// `belief` q (m,) in, `next` (m,) its next fixed point; or, `by_others`, what the other landmarks
// alone say of each, which a gross landmark cannot sway. Derivatives only where they are wanted.
template <class Lanes>
void find_likelihood(const PosteriorData& data, const Observed<Number<Lanes>>& seen, const Pack<Lanes>& pack,
                     const LaneView<Lanes>& view, const Lanes* belief, bool by_others, bool derived,
                     const LikelihoodSpace<Lanes>& space, Likelihood<Lanes>& found, Lanes* next);

}  // namespace shapefit
