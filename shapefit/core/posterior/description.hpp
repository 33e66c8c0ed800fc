// Mean and covariance of all landmarks at modes of the posterior, one mode a lane.
//
// In the frame of the camera, with K = A C R^T the covariance of what is seen with all
// points, L the Cholesky factor of S_0, B = S_0^-1 1 and G the covariance of the
// translation (likelihood.hpp):
//
//     X = R mu + K^T alpha,    t = G 1^T S_0^-1 r,    y = s (X + t),
//     cov y = s^2 (R C R^T - (L^-1 K)^T (L^-1 K) + U G U^T) + J^T (H + I)^-1 J
//
// with U = 1 - K^T B, and J the derivatives of y over theta. Those of X for a turn G_i
// of the camera frame are G_i X - R C R^T G_i P^T alpha + K^T d(alpha), where d(alpha)
// = -S^-1 P of the terms before; for log s d(alpha) = S^-1 (-y + 2 V / (s^2 q) alpha).
// The mean depth is taken out of y.
#pragma once

#include "search.hpp"

namespace shapefit {

// Mean and covariance of the mode of each lane, and what they are made of.
struct Description {
    Description(Workspace& workspace, Index p)
        : p(p),
          d(tiled(3 * p)),
          n(tiled(2 * p)),
          place(workspace.zeros<Index>(p)),
          row(workspace.zeros<Index>(3 * p)),
          mean(workspace.zeros<Doubles>(d)),
          C(workspace.zeros<Doubles>(d * d)),
          K(workspace.zeros<Doubles>(d * n)),
          W(workspace.zeros<Doubles>(d * n)),
          U(workspace.zeros<Doubles>(2 * d)),
          J(workspace.zeros<Doubles>(VIEW * d)),
          change(workspace.zeros<Doubles>(VIEW * n)),
          white(workspace.zeros<Doubles>(VIEW * n)) {
        for (Index e = 0; e < 3 * p; ++e) row[e] = 3 * (e % p) + e / p;
    }

    // Mean of coordinate e of all x, then y, then z, and its covariance with another.
    Doubles mean_of(Index e) const { return mean[row[e]]; }
    Doubles covariance_of(Index e, Index f) const { return C[row[e] * d + row[f]]; }

    const Index p, d, n;      // coordinate a of landmark j is row 3 j + a
    Index* place;             // of a landmark among those seen, or -1 (p,)
    Index* row;               // of all x, then y, then z (3 p,)
    Doubles* mean;            // R mu, then X + t, at last y (d,)
    Doubles* C;               // R C R^T, at last cov y (d, d)
    Doubles* K;               // K^T (d, n)
    Doubles* W;               // (L^-1 K)^T (d, n)
    Doubles* U;               // (d, 2)
    Doubles* J;               // (4, d)
    Doubles *change, *white;  // d(alpha), and L^-1 times its right side (4, n)
};

// sum_i a_i b_i, lane by lane.
inline Doubles dot(const Doubles* a, const Doubles* b, Index n) {
    Doubles total = {};
    for (Index i = 0; i < n; ++i) total += a[i] * b[i];
    return total;
}

// out = G_i x for a vector x (3,), i = axis: the derivative of a turn about it.
inline void turn_about(int axis, const Doubles* x, Doubles* out) {
    const int b = (axis + 1) % 3, c = (axis + 2) % 3;
    out[axis] = Doubles{};
    out[b] = -x[c];
    out[c] = x[b];
}

// Write the entries of K^T for the visible landmark j at landmark k, and add the term
// - R C R^T G_i P^T alpha of j to J there; Q (3, 3) is the block (k, j) of R C R^T.
inline void add_block(const Observed<Doubles>& observed, Index k, Index j,
                      const Doubles* Q, const Doubles* alpha, Index n,
                      Description& to) {
    const Index e = 2 * to.place[j];
    const Doubles* slope = observed.slope + e;
    const Doubles raised[3] = {alpha[e], alpha[e + 1],
                               -slope[0] * alpha[e] - slope[1] * alpha[e + 1]};
    for (int b = 0; b < 3; ++b)
        for (int a = 0; a < 2; ++a)
            to.K[(3 * k + b) * n + e + a] = Q[3 * b + a] - slope[a] * Q[3 * b + 2];
    for (int i = 0; i < 3; ++i) {
        Doubles turned[3];
        turn_about(i, raised, turned);
        for (int b = 0; b < 3; ++b)
            to.J[i * to.d + 3 * k + b] -= inner3<Doubles>(Q + 3 * b, turned);
    }
}

// Rotate the component of each lane into the camera frame of its view: set the mean to
// R mu, C to R C R^T, K^T, J to the terms - R C R^T G_i P^T alpha of the turns, and
// `place`.
inline void turn_components(const PosteriorData& data,
                            const LaneWorkspace<Doubles>& lanes,
                            const LaneView<Doubles>& view, const Doubles* alpha,
                            Index n, Description& to) {
    const Observed<Doubles>& observed = lanes.observed;
    const RotationOf<Doubles>& R = view.R;
    for (Index e = 0; e < VIEW * to.d; ++e) to.J[e] = Doubles{};
    for (Index e = 0; e < to.d * n; ++e) to.K[e] = Doubles{};
    for (Index j = 0; j < to.p; ++j) to.place[j] = -1;
    for (Index e = 0; e < observed.m; ++e) to.place[observed.index[e]] = e;
    for (Index k = 0; k < to.p; ++k)
        for (Index j = 0; j <= k; ++j) {
            Doubles copied[9], CR[9], Q[9], transposed[9];
            const bool seen = to.place[k] >= 0 && to.place[j] >= 0;
            const Doubles* C =
                seen ? observed.covariance + 9 * (corner(to.place[k]) + to.place[j])
                     : copied;
            for (int e = 0; !seen && e < 9 * WIDTH; ++e)
                copied[e / WIDTH][e % WIDTH] =
                    data.covariances[lanes.component[e % WIDTH]]
                                    [e / WIDTH / 3 * to.p + k]
                                    [e / WIDTH % 3 * to.p + j];
            for (int a = 0; a < 3; ++a)
                for (int b = 0; b < 3; ++b)
                    CR[3 * b + a] = inner3<Doubles>(C + 3 * a, R + 3 * b);
            for (int a = 0; a < 3; ++a)
                for (int b = 0; b < 3; ++b) {
                    const Doubles entry = inner3<Doubles>(R + 3 * a, CR + 3 * b);
                    Q[3 * a + b] = transposed[3 * b + a] = entry;
                    to.C[(3 * k + a) * to.d + 3 * j + b] =
                        to.C[(3 * j + b) * to.d + 3 * k + a] = entry;
                }
            if (to.place[j] >= 0) add_block(observed, k, j, Q, alpha, n, to);
            if (to.place[k] >= 0 && j != k)
                add_block(observed, j, k, transposed, alpha, n, to);
        }
    for (Index j = 0; j < to.p; ++j) {
        Doubles mu[3];
        for (int e = 0; e < 3 * WIDTH; ++e)
            mu[e / WIDTH][e % WIDTH] =
                data.means[lanes.component[e % WIDTH]][e / WIDTH][j];
        for (int a = 0; a < 3; ++a) to.mean[3 * j + a] = inner3<Doubles>(R + 3 * a, mu);
    }
}

// Add to J all other terms of the derivatives of y / s, and let the mean, R mu + K^T
// alpha, become X + t.
inline void differentiate_points(const Observed<Doubles>& observed, const Doubles* q,
                                 Doubles shrunk, const Translation<Doubles>& t,
                                 const LikelihoodSpace<Doubles>& space, Index n,
                                 Description& to) {
    const Doubles *alpha = space.alpha, *Bx = alpha + n, *By = Bx + n;
    for (Index e = 0; e < VIEW * n; ++e) to.change[e] = Doubles{};
    for (Index j = 0; j < to.p; ++j)
        for (int i = 0; i < 3; ++i) {
            Doubles turned[3];
            turn_about(i, to.mean + 3 * j, turned);
            for (int a = 0; a < 3; ++a) to.J[i * to.d + 3 * j + a] += turned[a];
        }
    for (Index j = 0; j < observed.m; ++j) {
        const Doubles *V = observed.noise + 3 * j, *slope = observed.slope + 2 * j;
        const Doubles share = 2.0 * shrunk / q[j];
        for (int a = 0; a < 2; ++a) {
            const Index e = 2 * j + a, row = 3 * observed.index[j];
            for (int i = 0; i < 3; ++i) {
                const Doubles* J = to.J + i * to.d + row;
                to.change[i * n + e] = slope[a] * J[2] - J[a];
            }
            to.change[3 * n + e] =
                share * (V[a] * alpha[2 * j] + V[1 + a] * alpha[2 * j + 1]) -
                space.y[e];
        }
    }
    Doubles shift[VIEW][2];
    for (int i = 0; i < VIEW; ++i) {
        Doubles* x = to.change + i * n;
        const Doubles along = dot(Bx, x, n), across = dot(By, x, n);
        shift[i][0] = t.xx * along + t.xy * across;
        shift[i][1] = t.xy * along + t.yy * across;
        for (Index e = 0; e < 2 * observed.m; ++e) x[e] -= shift[i][e % 2];
    }
    multiply<VIEW>(n, space.L, to.change, to.white);
    multiply_transposed<VIEW>(n, space.L, to.white, to.change);
    for (Index e = 0; e < 3 * to.p; ++e) {
        const Doubles none{};
        for (int i = 0; i < VIEW; ++i)
            to.J[i * to.d + e] += dot(to.K + e * n, to.change + i * n, n) +
                                  (e % 3 < 2 ? shift[i][e % 3] : none);
        to.mean[e] += e % 3 == 0 ? t.x : e % 3 == 1 ? t.y : none;
        to.J[3 * to.d + e] += to.mean[e];
    }
}

// Subtract from the depths of each column of x (3 p, count), its rows 3 j + 2, their
// mean; rows begin `stride` numbers apart.
inline void centre_depth(Doubles* x, Index p, Index stride, Index count) {
    for (Index i = 0; i < count; ++i) {
        Doubles mean = {};
        for (Index j = 0; j < p; ++j) mean += x[(3 * j + 2) * stride + i];
        for (Index j = 0; j < p; ++j)
            x[(3 * j + 2) * stride + i] -= mean / static_cast<double>(p);
    }
}

// Turn C from R C R^T into cov y (3 p, 3 p), size = s^2: the whole of it, or only the
// blocks (3, 3) of each landmark.
inline void add_terms(const Translation<Doubles>& t, Doubles size, Index n, bool whole,
                      Description& to) {
    const auto add = [&](Index e, Index f, Doubles less) {
        const Doubles *u = to.U + 2 * e, *v = to.U + 2 * f;
        Doubles total = to.C[e * to.d + f] - less + u[0] * (t.xx * v[0] + t.xy * v[1]) +
                        u[1] * (t.xy * v[0] + t.yy * v[1]);
        for (int i = 0; i < VIEW; ++i) total += to.J[i * to.d + e] * to.J[i * to.d + f];
        to.C[e * to.d + f] = to.C[f * to.d + e] = size * total;
    };
    for (Index e = 0; !whole && e < 3 * to.p; ++e)
        for (Index f = e / 3 * 3; f <= e; ++f)
            add(e, f, dot(to.W + e * n, to.W + f * n, n));
    for (Index e = 0; whole && e < to.d; e += TILE)
        for (Index f = 0; f <= e; f += TILE) {
            Tile<Doubles> sums = {};
            add_products(
                sums, 0, n, [&](Index i, int r) { return to.W[(e + r) * n + i]; },
                [&](Index i, int c) { return to.W[(f + c) * n + i]; });
            for (int r = 0; r < TILE; ++r)
                for (int c = 0; c < TILE && f + c <= e + r; ++c)
                    add(e + r, f + c, sums[r][c]);
        }
}

// Set `to` to mean and covariance of all landmarks at the view of each lane. q (m,):
// the inlier probabilities; root_of (4, 4): W with W^T W = (H + I)^-1; `whole`: not
// only the blocks (3, 3) of each landmark.
inline void describe(const PosteriorData& data, const LaneWorkspace<Doubles>& lanes,
                     const LaneView<Doubles>& view, const Doubles* q,
                     const Doubles* root_of, bool whole, Description& to) {
    const Observed<Doubles>& observed = lanes.observed;
    const LikelihoodSpace<Doubles>& space = lanes.space.likelihood;
    const Index n = tiled(2 * observed.m);
    const Doubles shrink = exponential(-view.log_scale), size = 1.0 / (shrink * shrink);
    centre(observed, view, shrink, space);
    fill_covariance(observed, view, shrink * shrink, q, space);
    factorise(n, space.L, space.reciprocal);
    invert(n, space.L, space.reciprocal);
    const Translation<Doubles> t = solve(n, space);
    turn_components(data, lanes, view, space.alpha, n, to);
    const Doubles none{}, one = all(1.0);
    for (Index e = 0; e < 3 * to.p; ++e)
        to.mean[e] += dot(to.K + e * n, space.alpha, n);
    differentiate_points(observed, q, shrink * shrink, t, space, n, to);
    for (Index e = 0; e < 3 * to.p; ++e)
        for (int a = 0; a < 2; ++a)
            to.U[2 * e + a] = (e % 3 == a ? one : none) -
                              dot(to.K + e * n, space.alpha + (1 + a) * n, n);
    for (Index e = 0; e < 3 * to.p; e += 3)
        multiply<3>(n, space.L, to.K + e * n, to.W + e * n);
    for (Index e = 0; e < 3 * to.p; ++e) {
        Doubles row[VIEW];
        for (int i = 0; i < VIEW; ++i) row[i] = to.J[i * to.d + e];
        for (int i = 0; i < VIEW; ++i) {
            to.J[i * to.d + e] = none;
            for (int j = 0; j < VIEW; ++j)
                to.J[i * to.d + e] += root_of[VIEW * i + j] * row[j];
        }
    }
    for (Index e = 0; e < 3 * to.p; ++e) centre_depth(to.C + e * to.d, to.p, 1, 1);
    centre_depth(to.C, to.p, to.d, 3 * to.p);
    centre_depth(to.W, to.p, n, n);
    centre_depth(to.U, to.p, 2, 2);
    for (int i = 0; i < VIEW; ++i) centre_depth(to.J + i * to.d, to.p, 1, 1);
    centre_depth(to.mean, to.p, 1, 1);
    add_terms(t, size, n, whole, to);
    for (Index e = 0; e < 3 * to.p; ++e) to.mean[e] /= shrink;
}

}  // namespace shapefit
