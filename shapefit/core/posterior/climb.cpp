#include "climb.hpp"

namespace shapefit::SHAPEFIT_LEVEL {
namespace {

constexpr double LONGEST = 0.5;    // step, in radians and log s
constexpr double STILL = 1e-6;     // step that ends the climb
constexpr double FIRST_DAMPING = 1e-3, EASE = 0.1, HARDEN = 8, MOST_DAMPING = 1e7;
constexpr double HOPELESS = 25;    // below the best so far in log evidence
constexpr long EARLY = 2;  // rounds at the start in which the view rests, and the belief in a
                           // landmark comes from the others
constexpr double DIFFERENCE = 1e-6;  // of the Hessian, to one side

Lanes select(Lanes mask, Lanes yes, Lanes no) { return mask > 0.5 ? yes : no; }
Lanes indicate(Lanes value) { return value > 0.0 ? all(1.0) : Lanes{}; }

// x = A^-1 b, A (4, 4) made positive definite by small pivots lifted.
void solve_small(const Lanes* A, const Lanes* b, Lanes* x) {
    Lanes L[VIEW][VIEW], inverse[VIEW];
    for (int i = 0; i < VIEW; ++i) {
        for (int j = 0; j < i; ++j) {
            Lanes rest = A[VIEW * i + j];
            for (int k = 0; k < j; ++k) rest -= L[i][k] * L[j][k];
            L[i][j] = rest * inverse[j];
        }
        Lanes pivot = A[VIEW * i + i];
        for (int k = 0; k < i; ++k) pivot -= L[i][k] * L[i][k];
        inverse[i] = 1.0 / root(larger(pivot, all(1e-9)));
    }
    for (int i = 0; i < VIEW; ++i) {
        Lanes rest = b[i];
        for (int k = 0; k < i; ++k) rest -= L[i][k] * x[k];
        x[i] = rest * inverse[i];
    }
    for (int i = VIEW - 1; i >= 0; --i) {
        Lanes rest = x[i];
        for (int k = i + 1; k < VIEW; ++k) rest -= L[k][i] * x[k];
        x[i] = rest * inverse[i];
    }
}

// R <- exp([theta]_x) R by Rodrigues, s <- exp(theta_4) s.
void move(const LaneView& from, const Lanes* theta, LaneView& to) {
    const Lanes x = theta[0], y = theta[1], z = theta[2];
    const Lanes square = x * x + y * y + z * z;
    Lanes first, second;  // sin(a) / a, (1 - cos a) / a^2
    for (int lane = 0; lane < WIDTH; ++lane) {
        const double a = root(square[lane]);
        first[lane] = a > 1e-6 ? sin(a) / a : 1 - a * a / 6;
        const double half = 0.5 * a, sine = a > 1e-6 ? sin(half) / half : 1.0;
        second[lane] = 0.5 * sine * sine;
    }
    const Lanes K[9] = {Lanes{}, -z, y, z, Lanes{}, -x, -y, x, Lanes{}};
    for (int c = 0; c < 3; ++c) {
        Lanes u[3], v[3];
        for (int a = 0; a < 3; ++a)
            u[a] = K[3 * a] * from.R[c] + K[3 * a + 1] * from.R[3 + c] + K[3 * a + 2] * from.R[6 + c];
        for (int a = 0; a < 3; ++a) v[a] = K[3 * a] * u[0] + K[3 * a + 1] * u[1] + K[3 * a + 2] * u[2];
        for (int a = 0; a < 3; ++a) to.R[3 * a + c] = from.R[3 * a + c] + first * u[a] + second * v[a];
    }
    to.log_scale = from.log_scale + theta[3];
}

// B <- B + y y^T / <y, s> - B s s^T B / <s, B s> where <y, s> > 0.
void mend(Lanes* B, const Lanes* s, const Lanes* y) {
    Lanes Bs[VIEW], overlap = {}, square = {};
    for (int i = 0; i < VIEW; ++i) {
        Bs[i] = Lanes{};
        for (int j = 0; j < VIEW; ++j) Bs[i] += B[VIEW * i + j] * s[j];
        overlap += y[i] * s[i];
        square += Bs[i] * s[i];
    }
    const Lanes fine = indicate(overlap - 0.05 * square) * indicate(square);
    const Lanes up = select(fine, 1.0 / larger(overlap, all(1e-300)), Lanes{});
    const Lanes down = select(fine, 1.0 / larger(square, all(1e-300)), Lanes{});
    for (int i = 0; i < VIEW; ++i)
        for (int j = 0; j < VIEW; ++j) B[VIEW * i + j] += y[i] * y[j] * up - Bs[i] * Bs[j] * down;
}

void take(Lanes kept, LaneView& to, const LaneView& from) {
    for (int e = 0; e < 9; ++e) to.R[e] = select(kept, from.R[e], to.R[e]);
    to.log_scale = select(kept, from.log_scale, to.log_scale);
}

}  // namespace

Climb::Climb(Workspace& workspace, long p)
    : belief(workspace.zeros<Lanes>(p)),
      next(workspace.zeros<Lanes>(p)),
      tried_belief(workspace.zeros<Lanes>(p)),
      tried_next(workspace.zeros<Lanes>(p)) {}

long climb(const PosteriorData& data, const Observed& seen, const Pack& pack, Lanes log_weight,
           double& best, const LikelihoodSpace& space, Climb& at) {
    const long m = seen.m;
    for (long j = 0; j < m; ++j) at.belief[j] = all(1.0);
    find_likelihood(data, seen, pack, at.view, at.belief, true, space, at.found, at.next);
    Lanes B[VIEW * VIEW], damping = all(FIRST_DAMPING), moving = all(1.0);
    for (int e = 0; e < VIEW * VIEW; ++e) B[e] = at.found.curvature[e];
    long steps = 0;
    for (long round = 0; round < data.most_rounds && largest(moving) > 0; ++round) {
        ++steps;
        Lanes A[VIEW * VIEW], minus[VIEW], step[VIEW];
        for (int e = 0; e < VIEW * VIEW; ++e) A[e] = B[e];
        for (int i = 0; i < VIEW; ++i) {
            A[(VIEW + 1) * i] += damping * (A[(VIEW + 1) * i] + 1e-6);
            minus[i] = -at.found.gradient[i];
        }
        solve_small(A, minus, step);
        Lanes length = {}, slope = {};
        for (int i = 0; i < VIEW; ++i) length += step[i] * step[i];
        length = root(length);
        const bool early = data.chance > 0 && round < EARLY;
        const Lanes cut = (early ? Lanes{} : moving) * smaller(all(1.0), LONGEST / larger(length, all(1e-300)));
        for (int i = 0; i < VIEW; ++i) {
            step[i] *= cut;
            slope -= step[i] * at.found.gradient[i];
        }
        move(at.view, step, at.tried);
        for (long j = 0; j < m; ++j) at.tried_belief[j] = at.next[j];
        find_likelihood(data, seen, pack, at.tried, at.tried_belief, early, space, at.there,
                        at.tried_next);
        const Lanes gain = at.there.value - at.found.value;
        const Lanes kept = early ? moving : moving * indicate(gain + 1e-9);
        Lanes change[VIEW], mended[VIEW * VIEW];
        for (int i = 0; i < VIEW; ++i) change[i] = at.there.gradient[i] - at.found.gradient[i];
        for (int e = 0; e < VIEW * VIEW; ++e) mended[e] = data.chance > 0 ? at.there.curvature[e] : B[e];
        mend(mended, step, change);
        for (int e = 0; e < VIEW * VIEW; ++e) B[e] = select(kept, mended[e], B[e]);
        take(kept, at.view, at.tried);
        Lanes* to = &at.found.value;
        const Lanes* from = &at.there.value;
        for (unsigned e = 0; e < sizeof(Likelihood) / sizeof(Lanes); ++e) to[e] = select(kept, from[e], to[e]);
        for (long j = 0; j < m; ++j) {
            at.belief[j] = select(kept, at.tried_belief[j], at.belief[j]);
            at.next[j] = select(kept, at.tried_next[j], at.next[j]);
        }
        damping = select(kept, larger(damping * EASE, all(1e-9)), damping * HARDEN);
        const Lanes value = at.found.value + log_weight;
        best = larger(best, largest(value));
        const Lanes still = indicate(STILL - length) * indicate(1e-6 - gain) * kept;
        const Lanes lost = indicate(best - HOPELESS - value - 4.0 * slope) * kept;
        moving *= (early ? all(1.0) : (1.0 - still) * (1.0 - lost)) * indicate(MOST_DAMPING - damping);
    }
    return steps;
}

void measure_hessian(const PosteriorData& data, const Observed& seen, const Pack& pack,
                     const LikelihoodSpace& space, Climb& at) {
    for (int i = 0; i < VIEW; ++i) {
        Lanes step[VIEW] = {};
        step[i] = all(DIFFERENCE);
        move(at.view, step, at.tried);
        find_likelihood(data, seen, pack, at.tried, at.belief, false, space, at.there,
                        at.tried_next);
        for (int j = 0; j < VIEW; ++j)
            at.hessian[VIEW * i + j] = (at.there.gradient[j] - at.found.gradient[j]) / DIFFERENCE;
    }
    for (int i = 0; i < VIEW; ++i)
        for (int j = 0; j < i; ++j)
            at.hessian[VIEW * i + j] = at.hessian[VIEW * j + i] =
                0.5 * (at.hessian[VIEW * i + j] + at.hessian[VIEW * j + i]);
}

}  // namespace shapefit::SHAPEFIT_LEVEL
