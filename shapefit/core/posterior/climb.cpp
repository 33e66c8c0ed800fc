#include "climb.hpp"

namespace shapefit {
namespace {

constexpr double LONGEST = 0.5;    // step, in radians and log s
constexpr double FIRST_DAMPING = 1e-3, EASE = 0.1, HARDEN = 8, MOST_DAMPING = 1e7;
constexpr long EARLY = 3;  // times that beliefs come from the other landmarks, at the start
// Of a value.
template <class Lanes>
constexpr double ROUNDING = sizeof(Number<Lanes>) < sizeof(double) ? 1e-4 : 1e-9;
constexpr double DIFFERENCE = 2e-7;  // of the Hessian, to one side
// Newton's last step: a longer one, or one that gains more, is no small one (the gain is half the
// square of Newton's decrement).
constexpr double LAST_LENGTH = 0.1, LAST_GAIN = 1e-2;

template <class Lanes>
Lanes select(Lanes mask, Lanes yes, Lanes no) { return mask > 0.5 ? yes : no; }
template <class Lanes>
Lanes indicate(Lanes value) { return value > 0.0 ? all<Lanes>(1.0) : Lanes{}; }

// x = A^-1 b, A (4, 4) made positive definite by small pivots lifted.
template <class Lanes>
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
        inverse[i] = 1.0 / root(larger(pivot, all<Lanes>(1e-9)));
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
template <class Lanes>
void move(const LaneView<Lanes>& from, const Lanes* theta, LaneView<Lanes>& to) {
    const Lanes x = theta[0], y = theta[1], z = theta[2];
    const Lanes square = x * x + y * y + z * z;
    Lanes first, second;  // sin(a) / a, (1 - cos a) / a^2
    for (int lane = 0; lane < width<Lanes>; ++lane) {
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
template <class Lanes>
void mend(Lanes* B, const Lanes* s, const Lanes* y) {
    Lanes Bs[VIEW], overlap = {}, square = {};
    for (int i = 0; i < VIEW; ++i) {
        Bs[i] = Lanes{};
        for (int j = 0; j < VIEW; ++j) Bs[i] += B[VIEW * i + j] * s[j];
        overlap += y[i] * s[i];
        square += Bs[i] * s[i];
    }
    const Lanes fine = indicate(overlap - square * all<Lanes>(0.05)) * indicate(square);
    const Lanes up = select(fine, 1.0 / larger(overlap, all<Lanes>(1e-30)), Lanes{});
    const Lanes down = select(fine, 1.0 / larger(square, all<Lanes>(1e-30)), Lanes{});
    for (int i = 0; i < VIEW; ++i)
        for (int j = 0; j < VIEW; ++j) B[VIEW * i + j] += y[i] * y[j] * up - Bs[i] * Bs[j] * down;
}

template <class Lanes>
void take(Lanes kept, LaneView<Lanes>& to, const LaneView<Lanes>& from) {
    for (int e = 0; e < 9; ++e) to.R[e] = select(kept, from.R[e], to.R[e]);
    to.log_scale = select(kept, from.log_scale, to.log_scale);
}

template <class Lanes>
void keep(Lanes kept, Likelihood<Lanes>& to, const Likelihood<Lanes>& from) {
    Lanes* old = &to.value;
    const Lanes* other = &from.value;
    for (unsigned e = 0; e < sizeof(Likelihood<Lanes>) / sizeof(Lanes); ++e)
        old[e] = select(kept, other[e], old[e]);
}

// The damped step, and what it promises to gain.
template <class Lanes>
Lanes propose(const Climb<Lanes>& at, Lanes* step) {
    Lanes A[VIEW * VIEW], down[VIEW], slope = {}, length = {};
    for (int e = 0; e < VIEW * VIEW; ++e) A[e] = at.curvature[e];
    for (int i = 0; i < VIEW; ++i) {
        A[(VIEW + 1) * i] += at.damping * (A[(VIEW + 1) * i] + all<Lanes>(1e-6));
        down[i] = -at.found.gradient[i];
    }
    solve_small(A, down, step);
    for (int i = 0; i < VIEW; ++i) length += step[i] * step[i];
    const Lanes cut = at.moving * smaller(all<Lanes>(1.0), LONGEST / larger(root(length), all<Lanes>(1e-30)));
    for (int i = 0; i < VIEW; ++i) slope += (step[i] *= cut) * down[i];
    return 0.5 * slope;
}

// A rotation to the last digit, from one in single precision.
template <class Lanes>
void orthonormalise(Lanes* R) {
    Lanes *x = R, *y = R + 3, *z = R + 6;
    const Lanes first = 1.0 / root(x[0] * x[0] + x[1] * x[1] + x[2] * x[2]);
    for (int c = 0; c < 3; ++c) x[c] *= first;
    const Lanes along = x[0] * y[0] + x[1] * y[1] + x[2] * y[2];
    for (int c = 0; c < 3; ++c) y[c] -= along * x[c];
    const Lanes second = 1.0 / root(y[0] * y[0] + y[1] * y[1] + y[2] * y[2]);
    for (int c = 0; c < 3; ++c) y[c] *= second;
    for (int c = 0; c < 3; ++c)
        z[c] = x[(c + 1) % 3] * y[(c + 2) % 3] - x[(c + 2) % 3] * y[(c + 1) % 3];
}

// Newton's step, where it is small, and then nothing is left to climb; returns what it gains.
template <class Lanes>
Lanes take_last_step(Climb<Lanes>& at) {
    Lanes down[VIEW], step[VIEW], gain = {}, length = {};
    for (int i = 0; i < VIEW; ++i) down[i] = -at.found.gradient[i];
    solve_small(at.curvature, down, step);
    for (int i = 0; i < VIEW; ++i) {
        gain += 0.5 * step[i] * down[i];
        length += step[i] * step[i];
    }
    const Lanes small = indicate(all<Lanes>(LAST_LENGTH * LAST_LENGTH) - length) *
                        indicate(all<Lanes>(LAST_GAIN) - gain);
    for (int i = 0; i < VIEW; ++i) step[i] *= small;
    move(at.view, step, at.view);
    at.moving = 1.0 - small;
    return select(small, gain, Lanes{});
}

}  // namespace

template <class Lanes>
ClimbSpace<Lanes>::ClimbSpace(Workspace& workspace, long p)
    : likelihood(workspace, tiled(2 * p)),
      belief(workspace.zeros<Lanes>(p)),
      next(workspace.zeros<Lanes>(p)) {}

template <class Lanes>
void begin(const PosteriorData& data, const Observed<Number<Lanes>>& seen, const Pack<Lanes>& pack, ClimbSpace<Lanes>& space,
           Climb<Lanes>& at) {
    const long m = seen.m;
    for (long j = 0; j < m; ++j) at.next(m)[j] = all<Lanes>(1.0);
    for (long left = data.chance > 0 ? EARLY : 1; left--;) {
        for (long j = 0; j < m; ++j) at.belief()[j] = at.next(m)[j];
        find_likelihood(data, seen, pack, at.view, at.belief(), true, left == 0, space.likelihood, at.found,
                        at.next(m));
    }
    for (int e = 0; e < VIEW * VIEW; ++e) at.curvature[e] = at.found.curvature[e];
    at.damping = all<Lanes>(FIRST_DAMPING);
    at.moving = all<Lanes>(1.0);
    Lanes step[VIEW];
    at.hope = propose(at, step);
}

template <class Lanes>
void climb(const PosteriorData& data, const Observed<Number<Lanes>>& seen, const Pack<Lanes>& pack, long rounds,
           ClimbSpace<Lanes>& space, Climb<Lanes>& at) {
    const long m = seen.m;
    const Lanes enough = all<Lanes>(data.still);
    for (long round = 0; round < rounds && largest(at.moving) > 0; ++round) {
        Lanes step[VIEW], change[VIEW], mended[VIEW * VIEW];
        propose(at, step);
        move(at.view, step, space.view);
        for (long j = 0; j < m; ++j) space.belief[j] = at.next(m)[j];
        find_likelihood(data, seen, pack, space.view, space.belief, false, true, space.likelihood,
                        space.found, space.next);
        const Lanes gain = space.found.value - at.found.value;
        const Lanes kept = at.moving * indicate(gain + all<Lanes>(ROUNDING<Lanes>)) *
                           indicate(at.largest - space.view.log_scale);
        for (int i = 0; i < VIEW; ++i) change[i] = space.found.gradient[i] - at.found.gradient[i];
        for (int e = 0; e < VIEW * VIEW; ++e)
            mended[e] = data.chance > 0 ? space.found.curvature[e] : at.curvature[e];
        mend(mended, step, change);
        for (int e = 0; e < VIEW * VIEW; ++e)
            at.curvature[e] = select(kept, mended[e], at.curvature[e]);
        take(kept, at.view, space.view);
        keep(kept, at.found, space.found);
        for (long j = 0; j < m; ++j) {
            at.belief()[j] = select(kept, space.belief[j], at.belief()[j]);
            at.next(m)[j] = select(kept, space.next[j], at.next(m)[j]);
        }
        at.damping = select(kept, larger(at.damping * all<Lanes>(EASE), all<Lanes>(1e-9)), at.damping * HARDEN);
        at.hope = propose(at, step);
        const Lanes still = indicate(enough - at.hope) * indicate(enough - gain) * kept;
        at.moving *= (1.0 - still) * indicate(MOST_DAMPING - at.damping);
    }
}

template <class Lanes>
void finish(const PosteriorData& data, const Observed<Number<Lanes>>& seen,
            const Pack<Lanes>& pack, ClimbSpace<Lanes>& space, Climb<Lanes>& at) {
    const auto look = [&](const LaneView<Lanes>& view, Likelihood<Lanes>& found) {
        find_likelihood(data, seen, pack, view, at.belief(), false, true, space.likelihood, found,
                        space.next);
    };
    orthonormalise(at.view.R);
    look(at.view, at.found);
    take_last_step(at);
    for (long j = 0; j < seen.m; ++j) at.belief()[j] = space.next[j];
    look(at.view, at.found);
    Lanes* H = at.curvature;
    for (int i = 0; i < VIEW; ++i) {
        Lanes step[VIEW] = {};
        step[i] = all<Lanes>(DIFFERENCE);
        move(at.view, step, space.view);
        look(space.view, space.found);
        for (int j = 0; j < VIEW; ++j)
            H[VIEW * i + j] = (space.found.gradient[j] - at.found.gradient[j]) / DIFFERENCE;
    }
    for (int i = 0; i < VIEW; ++i)
        for (int j = 0; j < i; ++j)
            H[VIEW * i + j] = H[VIEW * j + i] = 0.5 * (H[VIEW * i + j] + H[VIEW * j + i]);
    at.found.value += take_last_step(at);
}

template struct ClimbSpace<Doubles>;
template struct ClimbSpace<Singles>;
template void begin(const PosteriorData&, const Observed<float>&, const Pack<Singles>&,
                    ClimbSpace<Singles>&, Climb<Singles>&);
template void climb(const PosteriorData&, const Observed<float>&, const Pack<Singles>&, long,
                    ClimbSpace<Singles>&, Climb<Singles>&);
template void begin(const PosteriorData&, const Observed<double>&, const Pack<Doubles>&,
                    ClimbSpace<Doubles>&, Climb<Doubles>&);
template void climb(const PosteriorData&, const Observed<double>&, const Pack<Doubles>&, long,
                    ClimbSpace<Doubles>&, Climb<Doubles>&);
template void finish(const PosteriorData&, const Observed<double>&, const Pack<Doubles>&,
                     ClimbSpace<Doubles>&, Climb<Doubles>&);

}  // namespace shapefit
