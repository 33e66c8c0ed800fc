// Ascent to a maximum of the log likelihood L(theta) over the view, a start and a
// component of the mixture a lane. Damped Newton steps with a quasi-Newton curvature:
//
//     theta = (B + mu diag(B) + 1e-6 mu I)^-1 dL,    |theta| <= MAX_STEP,
//     R <- exp([theta_1..3]_x) R,    s <- exp(theta_4) s.
//
// B is the Gauss-Newton curvature of -L, updated after each step by BFGS; a step that
// raises L is accepted and mu falls, else mu rises.
#pragma once

#include "likelihood.hpp"

namespace shapefit {

constexpr double MAX_STEP = 0.5;  // length of a step, in radians and log s
// mu at the start, its factors after a step was accepted or not, and where a lane
// stops.
constexpr double FIRST_DAMPING = 1e-3;
constexpr double DAMPING_DECREASE = 0.1, DAMPING_INCREASE = 8;
constexpr double MAX_DAMPING = 1e7;
// Rounds at the start in which the inlier probability of a landmark comes from the
// others alone.
constexpr Index FIRST_INLIER_ROUNDS = 3;
// By which rounding may lower the log likelihood.
template <class Lanes>
constexpr double ROUNDING = sizeof(Number<Lanes>) < sizeof(double) ? 1e-4 : 1e-9;
constexpr double DIFFERENCE = 2e-7;  // of the Hessian, to one side
// Length and gain of the largest last Newton step: only where it is smaller is it
// taken, and has the lane converged. The gain is half the square of Newton's decrement.
constexpr double MAX_LAST_LENGTH = 0.1, MAX_LAST_GAIN = 1e-2;

// The state of the ascents of a block, one a lane.
template <class Lanes>
struct Ascent {
    LaneView<Lanes> view;
    Likelihood<Lanes> found;
    Lanes curvature[VIEW * VIEW];  // Gauss and Newton's, mended; at the end the Hessian
                                   // of -value
    Lanes damping;
    Lanes moving;          // 1, or 0 where a lane has arrived
    Lanes predicted_gain;  // what the next step is expected to gain
    Lanes largest;         // log of the scale beyond which no step goes
    Lanes before;  // the value with which the ascent ended, in single precision or in
                   // double

    Lanes *inlier_probability, *next;  // (p,), of which the first m count
};

// Call set(a, b) for each pair of vectors at the same place of two likelihoods, to copy
// lanes of one into the other.
template <class One, class Other, class Set>
[[gnu::always_inline]] inline void each_pair(Likelihood<One>& one,
                                             const Likelihood<Other>& other,
                                             const Set& set) {
    set(one.value, other.value);
    for (int i = 0; i < VIEW; ++i) set(one.gradient[i], other.gradient[i]);
    for (int e = 0; e < VIEW * VIEW; ++e) set(one.curvature[e], other.curvature[e]);
    set(one.squared_mahalanobis, other.squared_mahalanobis);
}
// Call set(a, b) for each pair of vectors at the same place of two ascents of p
// landmarks, to copy lanes of one into the other.
template <class One, class Other, class Set>
void each_pair(Ascent<One>& one, const Ascent<Other>& other, Index p, const Set& set) {
    for (int e = 0; e < 9; ++e) set(one.view.R[e], other.view.R[e]);
    set(one.view.log_scale, other.view.log_scale);
    each_pair(one.found, other.found, set);
    for (int e = 0; e < VIEW * VIEW; ++e) set(one.curvature[e], other.curvature[e]);
    set(one.damping, other.damping);
    set(one.moving, other.moving);
    set(one.predicted_gain, other.predicted_gain);
    set(one.largest, other.largest);
    for (Index j = 0; j < p; ++j) {
        set(one.inlier_probability[j], other.inlier_probability[j]);
        set(one.next[j], other.next[j]);
    }
}

// Memory for the ascents of a block: a trial step, and the likelihood there.
template <class Lanes>
struct AscentSpace {
    AscentSpace(Workspace& workspace, Index p)
        : likelihood(workspace, tiled(2 * p)),
          inlier_probability(workspace.zeros<Lanes>(p)),
          next(workspace.zeros<Lanes>(p)) {}

    LikelihoodSpace<Lanes> likelihood;
    LaneView<Lanes> view;
    Likelihood<Lanes> found;
    Lanes *inlier_probability, *next;  // (m,)
};

// `yes` where the mask is 1, `no` where it is 0.
template <class Lanes>
Lanes select(Lanes mask, Lanes yes, Lanes no) {
    return mask > 0.5 ? yes : no;
}
// 1 where a value is positive, else 0.
template <class Lanes>
Lanes indicate(Lanes value) {
    return value > 0.0 ? all<Lanes>(1.0) : Lanes{};
}

// x = A^-1 b over theta, A (4, 4) made positive definite by raising small pivots.
template <class Lanes>
void solve_view(const Lanes* A, const Lanes* b, Lanes* x) {
    static_assert(VIEW == TILE);
    Lanes L[VIEW * VIEW], reciprocal[VIEW], white[VIEW];
    const Triangle<Lanes> factor{L};
    for (int e = 0; e < VIEW * VIEW; ++e) L[e] = A[e];
    factorise(VIEW, factor, reciprocal);
    invert(VIEW, factor, reciprocal);
    multiply<1>(VIEW, factor, b, white);
    multiply_transposed<1>(VIEW, factor, white, x);
}

// Set `to` to the view `from` moved by theta: R <- exp([theta_1..3]_x) R, s <-
// exp(theta_4) s.
template <class Lanes>
void move(const LaneView<Lanes>& from, const Lanes* theta, LaneView<Lanes>& to) {
    to = {from.R.turned(theta), from.log_scale + theta[3]};
}

// Update the curvature B after a step s that changed the gradient by y (BFGS): B <- B +
// y y^T / <y, s> - B s s^T B / <s, B s>, in lanes where <y, s> is clearly positive.
template <class Lanes>
void update_curvature(Lanes* B, const Lanes* s, const Lanes* y) {
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
        for (int j = 0; j < VIEW; ++j)
            B[VIEW * i + j] += y[i] * y[j] * up - Bs[i] * Bs[j] * down;
}

// to <- from in the lanes where `accepted` is 1.
template <class Lanes>
void copy_accepted(Lanes accepted, LaneView<Lanes>& to, const LaneView<Lanes>& from) {
    for (int e = 0; e < 9; ++e) to.R[e] = select(accepted, from.R[e], to.R[e]);
    to.log_scale = select(accepted, from.log_scale, to.log_scale);
}

// Set step (4,) to the damped Newton step of each lane that moves, else 0; returns the
// gain in log likelihood that it promises.
template <class Lanes>
Lanes propose(const Ascent<Lanes>& at, Lanes* step) {
    Lanes A[VIEW * VIEW], down[VIEW], slope = {}, length = {};
    for (int e = 0; e < VIEW * VIEW; ++e) A[e] = at.curvature[e];
    for (int i = 0; i < VIEW; ++i) {
        A[(VIEW + 1) * i] += at.damping * (A[(VIEW + 1) * i] + all<Lanes>(1e-6));
        down[i] = -at.found.gradient[i];
    }
    solve_view(A, down, step);
    for (int i = 0; i < VIEW; ++i) length += step[i] * step[i];
    const Lanes cut =
        at.moving *
        smaller(all<Lanes>(1.0), MAX_STEP / larger(root(length), all<Lanes>(1e-30)));
    for (int i = 0; i < VIEW; ++i) slope += (step[i] *= cut) * down[i];
    return 0.5 * slope;
}

// Move by Newton's step where it is small; lanes where it is not stay `moving`. Returns
// the gain in log likelihood that it promises.
template <class Lanes>
Lanes take_last_step(Ascent<Lanes>& at) {
    Lanes down[VIEW], step[VIEW], gain = {}, length = {};
    for (int i = 0; i < VIEW; ++i) down[i] = -at.found.gradient[i];
    solve_view(at.curvature, down, step);
    for (int i = 0; i < VIEW; ++i) {
        gain += 0.5 * step[i] * down[i];
        length += step[i] * step[i];
    }
    const Lanes small =
        indicate(all<Lanes>(MAX_LAST_LENGTH * MAX_LAST_LENGTH) - length) *
        indicate(all<Lanes>(MAX_LAST_GAIN) - gain);
    for (int i = 0; i < VIEW; ++i) step[i] *= small;
    move(at.view, step, at.view);
    at.moving = 1.0 - small;
    return select(small, gain, Lanes{});
}

// Evaluate the likelihood at the views where the ascents start, with the inlier
// probability of each landmark by the others, and set damping and the rest of their
// state.
template <class Lanes>
void begin(const PosteriorData& data, const Observed<Lanes>& observed,
           AscentSpace<Lanes>& space, Ascent<Lanes>& at) {
    const Index m = observed.m;
    for (Index j = 0; j < m; ++j) at.next[j] = all<Lanes>(1.0);
    for (Index left = data.chance > 0 ? FIRST_INLIER_ROUNDS : 1; left--;) {
        for (Index j = 0; j < m; ++j) at.inlier_probability[j] = at.next[j];
        find_likelihood(data, observed, at.view, at.inlier_probability, true,
                        left ? Wanted::INLIERS : Wanted::CURVATURE, space.likelihood,
                        at.found, at.next);
    }
    for (int e = 0; e < VIEW * VIEW; ++e) at.curvature[e] = at.found.curvature[e];
    at.damping = all<Lanes>(FIRST_DAMPING);
    at.moving = all<Lanes>(1.0);
    Lanes step[VIEW];
    at.predicted_gain = propose(at, step);
}

// Take at most `rounds` damped steps of each ascent, with the Gauss-Newton curvature,
// updated by BFGS. Lanes that have converged are `moving` no more. Where every landmark
// is an outlier the likelihood grows with the scale for ever: there steps end at
// `largest`.
template <class Lanes>
void ascend(const PosteriorData& data, const Observed<Lanes>& observed, Index rounds,
            AscentSpace<Lanes>& space, Ascent<Lanes>& at) {
    const Index m = observed.m;
    const Lanes enough = all<Lanes>(data.tolerance);
    const Wanted wanted = data.chance > 0 ? Wanted::CURVATURE : Wanted::GRADIENT;
    for (Index round = 0; round < rounds && largest(at.moving) > 0; ++round) {
        check_interrupt();
        Lanes step[VIEW], change[VIEW], mended[VIEW * VIEW];
        propose(at, step);
        move(at.view, step, space.view);
        for (Index j = 0; j < m; ++j) space.inlier_probability[j] = at.next[j];
        find_likelihood(data, observed, space.view, space.inlier_probability, false,
                        wanted, space.likelihood, space.found, space.next);
        const Lanes gain = space.found.value - at.found.value;
        const Lanes accepted = at.moving *
                               indicate(gain + all<Lanes>(ROUNDING<Lanes>)) *
                               indicate(at.largest - space.view.log_scale);
        for (int i = 0; i < VIEW; ++i)
            change[i] = space.found.gradient[i] - at.found.gradient[i];
        for (int e = 0; e < VIEW * VIEW; ++e)
            mended[e] = data.chance > 0 ? space.found.curvature[e] : at.curvature[e];
        update_curvature(mended, step, change);
        for (int e = 0; e < VIEW * VIEW; ++e)
            at.curvature[e] = select(accepted, mended[e], at.curvature[e]);
        copy_accepted(accepted, at.view, space.view);
        each_pair(at.found, space.found,
                  [&](Lanes& old, Lanes found) { old = select(accepted, found, old); });
        for (Index j = 0; j < m; ++j) {
            at.inlier_probability[j] =
                select(accepted, space.inlier_probability[j], at.inlier_probability[j]);
            at.next[j] = select(accepted, space.next[j], at.next[j]);
        }
        at.damping =
            select(accepted,
                   larger(at.damping * all<Lanes>(DAMPING_DECREASE), all<Lanes>(1e-9)),
                   at.damping * DAMPING_INCREASE);
        at.predicted_gain = select(at.moving, propose(at, step), at.predicted_gain);
        const Lanes converged =
            indicate(enough - at.predicted_gain) * indicate(enough - gain) * accepted;
        at.moving *= (1.0 - converged) * indicate(MAX_DAMPING - at.damping);
    }
}

// Take one more Newton step where an ascent has ended, with the next inlier
// probabilities, and evaluate the likelihood there.
template <class Lanes>
void evaluate_end(const PosteriorData& data, const Observed<Lanes>& observed,
                  AscentSpace<Lanes>& space, Ascent<Lanes>& at) {
    at.view.R.orthonormalise();  // to the last digit, from one in single precision
    for (int again = 1; again >= 0; --again) {
        find_likelihood(data, observed, at.view, at.inlier_probability, false,
                        Wanted::GRADIENT, space.likelihood, at.found, space.next);
        if (again) take_last_step(at);
        for (Index j = 0; again && j < observed.m; ++j)
            at.inlier_probability[j] = space.next[j];
    }
}

// Set the curvature to the Hessian where an ascent has ended, by differences of
// gradients, with the inlier probabilities fixed.
template <class Lanes>
void find_hessian(const PosteriorData& data, const Observed<Lanes>& observed,
                  AscentSpace<Lanes>& space, Ascent<Lanes>& at) {
    for (int i = 0; i < VIEW; ++i) {
        Lanes step[VIEW] = {};
        step[i] = all<Lanes>(DIFFERENCE);
        move(at.view, step, space.view);
        find_likelihood(data, observed, space.view, at.inlier_probability, false,
                        Wanted::GRADIENT, space.likelihood, space.found, space.next);
        for (int j = 0; j < VIEW; ++j)
            at.curvature[VIEW * i + j] =
                (space.found.gradient[j] - at.found.gradient[j]) / DIFFERENCE;
    }
}

// Make the Hessian symmetric and take Newton's last step with it. A lane is still
// `moving` where that is not small: it has reached no stationary point.
template <class Lanes>
void finish(Ascent<Lanes>& at) {
    Lanes* H = at.curvature;
    for (int i = 0; i < VIEW; ++i)
        for (int j = 0; j < i; ++j)
            H[VIEW * i + j] = H[VIEW * j + i] =
                0.5 * (H[VIEW * i + j] + H[VIEW * j + i]);
    at.found.value += take_last_step(at);
}

}  // namespace shapefit
