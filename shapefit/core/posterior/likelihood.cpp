#include "likelihood.hpp"

#include "../algebra/logarithm.hpp"

namespace shapefit::SHAPEFIT_LEVEL {
namespace {

constexpr double LOG_TWO_PI = 1.8378770664093453;
constexpr double LEAST_PIVOT = 1e-12;

Lanes exponential(Lanes x) {
    for (int lane = 0; lane < WIDTH; ++lane) x[lane] = exp(x[lane]);
    return x;
}

Lanes logarithm(Lanes x) {
    constexpr double GROWN = 0x1p60, LOG_GROWN = 60 * 0x1.62e42fefa39efp-1;
    for (int lane = 0; lane < WIDTH; ++lane)
        x[lane] = log_of_one_plus(x[lane] * GROWN - 1.0) - LOG_GROWN;
    return x;
}

// N_j = v + V / s^2 as xx, xy, yy.
struct Noise {
    Lanes xx, xy, yy;
};

[[gnu::always_inline]] inline Noise noise_of(const Observed& seen, long j, Lanes shrunk) {
    const double* V = seen.noise + 3 * j;
    return {seen.misfit[j] + V[0] * shrunk, V[1] * shrunk, seen.misfit[j] + V[2] * shrunk};
}

void centre(const Observed& seen, const Pack& pack, const LaneView& view, Lanes shrunk,
            const LikelihoodSpace& space) {
    for (long j = 0; j < seen.m; ++j) {
        const Lanes* mu = pack.mean + 3 * seen.index[j];
        for (int a = 0; a < 3; ++a)
            space.mean[3 * j + a] = view.R[3 * a] * mu[0] + view.R[3 * a + 1] * mu[1] +
                                    view.R[3 * a + 2] * mu[2];
        for (int a = 0; a < 2; ++a) {
            const double slope = seen.slope[2 * j + a];
            for (int c = 0; c < 3; ++c)
                space.A[6 * j + 3 * a + c] = view.R[3 * a + c] - slope * view.R[6 + c];
            space.y[2 * j + a] = seen.w[2 * j + a] * shrunk;
            space.r[2 * j + a] = space.y[2 * j + a] - space.mean[3 * j + a] + slope * space.mean[3 * j + 2];
        }
    }
}

[[gnu::always_inline]] inline const Lanes* block_of(const Observed& seen, const Pack& pack, long j,
                                                    long k) {
    return pack.covariance + 9 * (corner(seen.index[j]) + seen.index[k]);
}

// T = A_j C (2, 3)
[[gnu::always_inline]] inline void project_rows(const Lanes* A, const Lanes* C, Lanes* T) {
    for (int a = 0; a < 2; ++a)
        for (int c = 0; c < 3; ++c)
            T[3 * a + c] = A[3 * a] * C[c] + A[3 * a + 1] * C[3 + c] + A[3 * a + 2] * C[6 + c];
}

void fill_covariance(const Observed& seen, const Pack& pack, Lanes shrunk, const Lanes* belief,
                     const LikelihoodSpace& space) {
    for (long j = 0; j < seen.m; ++j) {
        Lanes* upper = space.L + corner(2 * j);
        Lanes* lower = space.L + corner(2 * j + 1);
        for (long k = 0; k <= j; ++k) {
            Lanes T[6];
            project_rows(space.A + 6 * j, block_of(seen, pack, j, k), T);
            const Lanes* A = space.A + 6 * k;
            const Lanes first = T[0] * A[0] + T[1] * A[1] + T[2] * A[2] + TAU_SQUARE;
            const Lanes last = T[3] * A[3] + T[4] * A[4] + T[5] * A[5] + TAU_SQUARE;
            upper[2 * k] = first;
            lower[2 * k] = T[3] * A[0] + T[4] * A[1] + T[5] * A[2];
            lower[2 * k + 1] = last;
            if (k < j) upper[2 * k + 1] = T[0] * A[3] + T[1] * A[4] + T[2] * A[5];
        }
        const Noise N = noise_of(seen, j, shrunk);
        const Lanes share = 1.0 / belief[j];
        upper[2 * j] += N.xx * share;
        lower[2 * j] += N.xy * share;
        lower[2 * j + 1] += N.yy * share;
    }
}

// Four sums sum_k a_k b_k of two rows with two rows.
struct FourSums {
    Lanes s00 = {}, s01 = {}, s10 = {}, s11 = {};
    [[gnu::always_inline]] void add(const Lanes* a0, const Lanes* a1, const Lanes* b0,
                                    const Lanes* b1, long first, long last) {
        for (long k = first; k < last; ++k) {
            const Lanes x0 = a0[k], x1 = a1[k], z0 = b0[k], z1 = b1[k];
            s00 += x0 * z0;
            s01 += x0 * z1;
            s10 += x1 * z0;
            s11 += x1 * z1;
        }
    }
};

// S = L L^T in place, two rows at a time; returns log det S.
Lanes factorise(long N, const LikelihoodSpace& space) {
    Lanes log_det = {}, product = all(1.0);
    for (long i = 0; i < N; i += 2) {
        Lanes *a0 = space.L + corner(i), *a1 = space.L + corner(i + 1);
        for (long j = 0; j < i; j += 2) {
            const Lanes *b0 = space.L + corner(j), *b1 = space.L + corner(j + 1);
            FourSums sums;
            sums.add(a0, a1, b0, b1, 0, j);
            a0[j] = (a0[j] - sums.s00) * space.reciprocal[j];
            a1[j] = (a1[j] - sums.s10) * space.reciprocal[j];
            a0[j + 1] = (a0[j + 1] - sums.s01 - a0[j] * b1[j]) * space.reciprocal[j + 1];
            a1[j + 1] = (a1[j + 1] - sums.s11 - a1[j] * b1[j]) * space.reciprocal[j + 1];
        }
        FourSums sums;
        sums.add(a0, a1, a0, a1, 0, i);
        const Lanes first = larger(a0[i] - sums.s00, all(LEAST_PIVOT));
        space.reciprocal[i] = 1.0 / root(first);
        a0[i] = first * space.reciprocal[i];
        a1[i] = (a1[i] - sums.s10) * space.reciprocal[i];
        const Lanes second = larger(a1[i + 1] - sums.s11 - a1[i] * a1[i], all(LEAST_PIVOT));
        space.reciprocal[i + 1] = 1.0 / root(second);
        a1[i + 1] = second * space.reciprocal[i + 1];
        product *= first * second;
        if (i % 8 == 6 || i + 2 >= N) {
            log_det += logarithm(product);
            product = all(1.0);
        }
    }
    return log_det;
}

// L^-1 by columns, two columns and two rows at a time.
void invert(long N, const LikelihoodSpace& space) {
    for (long j = 0; j < N; j += 2) {
        Lanes *c0 = space.inverse + j * N, *c1 = c0 + N;
        c0[j] = space.reciprocal[j];
        c0[j + 1] = -space.L[corner(j + 1) + j] * c0[j] * space.reciprocal[j + 1];
        c1[j] = Lanes{};
        c1[j + 1] = space.reciprocal[j + 1];
        for (long i = j + 2; i < N; i += 2) {
            const Lanes *a0 = space.L + corner(i), *a1 = space.L + corner(i + 1);
            FourSums sums;
            sums.add(a0, a1, c0, c1, j, i);
            c0[i] = -sums.s00 * space.reciprocal[i];
            c1[i] = -sums.s01 * space.reciprocal[i];
            c0[i + 1] = -(sums.s10 + a1[i] * c0[i]) * space.reciprocal[i + 1];
            c1[i + 1] = -(sums.s11 + a1[i] * c1[i]) * space.reciprocal[i + 1];
        }
    }
}

// out = L^-1 x
void whiten(long N, const LikelihoodSpace& space, const Lanes* x, Lanes* __restrict out) {
    for (long i = 0; i < N; ++i) out[i] = Lanes{};
    for (long j = 0; j < N; ++j) {
        const Lanes* column = space.inverse + j * N;
        const Lanes factor = x[j];
        for (long i = j; i < N; ++i) out[i] += column[i] * factor;
    }
}

// alpha = L^-T white; returns |white|^2.
Lanes solve(long N, const LikelihoodSpace& space) {
    whiten(N, space, space.r, space.white);
    Lanes square = {};
    for (long i = 0; i < N; ++i) {
        const Lanes* column = space.inverse + i * N;
        Lanes total = {};
        for (long k = i; k < N; ++k) total += column[k] * space.white[k];
        space.alpha[i] = total;
        square += space.white[i] * space.white[i];
    }
    return square;
}

// Z += (z_0 z_1) P_j for the row c.
[[gnu::always_inline]] inline void add_along_ray(Lanes z0, Lanes z1, const double* slope, Lanes* row) {
    row[0] += z0;
    row[1] += z1;
    row[2] -= slope[0] * z0 + slope[1] * z1;
}

// X = R mu + R C A^T alpha, and Z = sum_jk C_kj A_j^T S^-1_jk P_k (3, 3), whose turned form gives
// tr(S^-1 dS) / 2 = tr(G R Z) for a turn R <- R + G R.
void pull_back(const Observed& seen, const Pack& pack, const LaneView& view,
               const LikelihoodSpace& space, Lanes* Z) {
    const long N = 2 * seen.m;
    const Lanes* R = view.R;
    for (int e = 0; e < 9; ++e) Z[e] = Lanes{};
    for (long j = 0; j < seen.m; ++j) space.X[3 * j] = space.X[3 * j + 1] = space.X[3 * j + 2] = Lanes{};
    for (long j = 0; j < seen.m; ++j) {
        const Lanes *a0 = space.inverse + 2 * j * N, *a1 = a0 + N;
        for (long k = 0; k <= j; ++k) {
            const Lanes *b0 = space.inverse + 2 * k * N, *b1 = b0 + N;
            FourSums inverse;  // S^-1_jk
            inverse.add(a0, a1, b0, b1, 2 * j, N);
            const Lanes* C = block_of(seen, pack, j, k);
            Lanes T[6];
            project_rows(space.A + 6 * j, C, T);
            const Lanes aj0 = space.alpha[2 * j], aj1 = space.alpha[2 * j + 1];
            for (int c = 0; c < 3; ++c) {
                add_along_ray(T[c] * inverse.s00 + T[3 + c] * inverse.s10,
                              T[c] * inverse.s01 + T[3 + c] * inverse.s11, seen.slope + 2 * k,
                              Z + 3 * c);
                space.X[3 * k + c] += T[c] * aj0 + T[3 + c] * aj1;
            }
            if (k == j) {
                space.diagonal[3 * j] = inverse.s00;
                space.diagonal[3 * j + 1] = inverse.s10;
                space.diagonal[3 * j + 2] = inverse.s11;
                continue;
            }
            const Lanes ak0 = space.alpha[2 * k], ak1 = space.alpha[2 * k + 1];
            const Lanes* A = space.A + 6 * k;
            for (int c = 0; c < 3; ++c) {
                const Lanes p0 = C[3 * c] * A[0] + C[3 * c + 1] * A[1] + C[3 * c + 2] * A[2];
                const Lanes p1 = C[3 * c] * A[3] + C[3 * c + 1] * A[4] + C[3 * c + 2] * A[5];
                add_along_ray(p0 * inverse.s00 + p1 * inverse.s01,
                              p0 * inverse.s10 + p1 * inverse.s11, seen.slope + 2 * j, Z + 3 * c);
                space.X[3 * j + c] += p0 * ak0 + p1 * ak1;
            }
        }
    }
    for (long j = 0; j < seen.m; ++j) {
        Lanes* X = space.X + 3 * j;
        const Lanes x = X[0], y = X[1], z = X[2];
        for (int a = 0; a < 3; ++a)
            X[a] = space.mean[3 * j + a] + R[3 * a] * x + R[3 * a + 1] * y + R[3 * a + 2] * z;
    }
}

// The derivatives of r: -P_j G_i X for the turns, -y for log s.
void linearise(const Observed& seen, const LikelihoodSpace& space) {
    const long N = 2 * seen.m;
    for (long j = 0; j < seen.m; ++j) {
        const Lanes* X = space.X + 3 * j;
        Lanes* J = space.J + 2 * j;
        const double *slope = seen.slope + 2 * j;
        J[0] = slope[0] * X[1];
        J[1] = X[2] + slope[1] * X[1];
        J[N] = -X[2] - slope[0] * X[0];
        J[N + 1] = -slope[1] * X[0];
        J[2 * N] = X[1];
        J[2 * N + 1] = -X[0];
        J[3 * N] = -space.y[2 * j];
        J[3 * N + 1] = -space.y[2 * j + 1];
    }
}

void differentiate(const Observed& seen, const LaneView& view, Lanes shrunk, const Lanes* belief,
                   const Lanes* Z, const LikelihoodSpace& space, Likelihood& found) {
    const long N = 2 * seen.m;
    linearise(seen, space);
    for (int i = 0; i < VIEW; ++i) {
        Lanes total = {};
        for (long e = 0; e < N; ++e) total += space.J[i * N + e] * space.alpha[e];
        found.gradient[i] = total;
    }
    Lanes H[9];  // R Z
    for (int a = 0; a < 3; ++a)
        for (int b = 0; b < 3; ++b)
            H[3 * a + b] = view.R[3 * a] * Z[b] + view.R[3 * a + 1] * Z[3 + b] + view.R[3 * a + 2] * Z[6 + b];
    found.gradient[0] += H[5] - H[7];
    found.gradient[1] += H[6] - H[2];
    found.gradient[2] += H[1] - H[3];
    found.gradient[3] += static_cast<double>(N - 2);
    if (seen.noisy)
        for (long j = 0; j < seen.m; ++j) {
            const double* V = seen.noise + 3 * j;
            const Lanes *alpha = space.alpha + 2 * j, *D = space.diagonal + 3 * j;
            const Noise noise = noise_of(seen, j, shrunk);
            const Lanes det = noise.xx * noise.yy - noise.xy * noise.xy;
            found.gradient[3] +=
                shrunk * ((V[0] * (alpha[0] * alpha[0] - D[0]) + V[2] * (alpha[1] * alpha[1] - D[2]) +
                           2.0 * V[1] * (alpha[0] * alpha[1] - D[1])) /
                              belief[j] +
                          (1.0 - belief[j]) *
                              (V[0] * noise.yy + V[2] * noise.xx - 2.0 * V[1] * noise.xy) / det);
        }
    Lanes* white = space.L;  // no longer needed
    for (int i = 0; i < VIEW; ++i) whiten(N, space, space.J + i * N, white + i * N);
    for (int i = 0; i < VIEW; ++i)
        for (int j = 0; j <= i; ++j) {
            Lanes total = {};
            for (long e = 0; e < N; ++e) total += white[i * N + e] * white[j * N + e];
            found.curvature[VIEW * i + j] = found.curvature[VIEW * j + i] = total;
        }
}

// log N(r; 0, P) of a landmark as the others predict it: with D = S^-1_jj and a = alpha_j it is
// off by r = D^-1 a, with the covariance P = D^-1 - N / q + N.
Lanes predict(const Noise& N, Lanes q, const Lanes* a, const Lanes* D) {
    const Lanes scale = 1.0 / (D[0] * D[2] - D[1] * D[1]);
    const Lanes rx = (D[2] * a[0] - D[1] * a[1]) * scale, ry = (D[0] * a[1] - D[1] * a[0]) * scale;
    const Lanes less = 1.0 - 1.0 / q;
    const Lanes xx = D[2] * scale + N.xx * less, yy = D[0] * scale + N.yy * less;
    const Lanes xy = -D[1] * scale + N.xy * less;
    const Lanes det = larger(xx * yy - xy * xy, all(1e-12));
    return -0.5 * ((yy * rx * rx - 2.0 * xy * rx * ry + xx * ry * ry) / det + logarithm(det)) -
           LOG_TWO_PI;
}

// Add the terms of the belief to value and surprise; the next belief.
void believe(const PosteriorData& data, const Observed& seen, const LaneView& view, Lanes shrunk,
             const Lanes* belief,
             bool by_others, const LikelihoodSpace& space, Likelihood& found, Lanes* next) {
    if (!(data.chance > 0)) {
        for (long j = 0; j < seen.m; ++j) next[j] = all(1.0);
        return;
    }
    const double kept = log1p(-data.chance);
    const Lanes gross = log(data.chance * data.density) + 2.0 * view.log_scale;
    for (long j = 0; j < seen.m; ++j) {
        const Noise N = noise_of(seen, j, shrunk);
        const Lanes q = belief[j], rest = 1.0 - q;
        found.gradient[3] -= 2.0 * rest;
        const Lanes log_size = 0.5 * logarithm(N.xx * N.yy - N.xy * N.xy) + LOG_TWO_PI;
        const Lanes *a = space.alpha + 2 * j, *D = space.diagonal + 3 * j;
        const Lanes square = N.xx * (a[0] * a[0] - D[0]) + 2.0 * N.xy * (a[0] * a[1] - D[1]) +
                             N.yy * (a[1] * a[1] - D[2]);
        const Lanes expected = square / (q * q) + 2.0 / q;
        const Lanes density = by_others ? predict(N, q, a, D) : -log_size - 0.5 * expected;
        const Lanes odds = kept + density - gross;
        const Lanes steep = larger(smaller(odds, all(40.0)), all(-40.0));
        next[j] = larger(1.0 / (1.0 + exponential(-steep)), all(LEAST_BELIEF));
        found.value += rest * (log_size + gross) + q * kept - (1.0 + q) * logarithm(q) -
                       rest * logarithm(rest + 1e-300);
        found.surprise += rest * 2.0 * larger(kept - log_size - gross, Lanes{});
    }
}

}  // namespace

LikelihoodSpace::LikelihoodSpace(Workspace& workspace, long p)
    : L(workspace.zeros<Lanes>(corner(2 * p) + VIEW * 2 * p)),
      inverse(workspace.zeros<Lanes>(4 * p * p)),
      reciprocal(workspace.zeros<Lanes>(2 * p)),
      y(workspace.zeros<Lanes>(2 * p)),
      r(workspace.zeros<Lanes>(2 * p)),
      white(workspace.zeros<Lanes>(2 * p)),
      alpha(workspace.zeros<Lanes>(2 * p)),
      mean(workspace.zeros<Lanes>(3 * p)),
      X(workspace.zeros<Lanes>(3 * p)),
      A(workspace.zeros<Lanes>(6 * p)),
      J(workspace.zeros<Lanes>(VIEW * 2 * p)),
      diagonal(workspace.zeros<Lanes>(3 * p)) {}

Observed room_for_observed(Workspace& workspace, long p) {
    Observed seen{};
    seen.index = workspace.zeros<long>(p);
    seen.w = workspace.zeros<double>(2 * p);
    seen.slope = workspace.zeros<double>(2 * p);
    seen.misfit = workspace.zeros<double>(p);
    seen.noise = workspace.zeros<double>(3 * p);
    return seen;
}

void observe(const PosteriorData& data, long image, Observed& seen) {
    const long p = data.landmarks.size[2];
    const double* V = data.noise[image].data;
    seen.m = 0;
    seen.noisy = false;
    for (long j = 0; j < p; ++j) {
        if (!is_finite(data.misfit[image][j])) continue;
        const long e = seen.m++;
        seen.index[e] = j;
        seen.misfit[e] = data.misfit[image][j];
        for (int a = 0; a < 2; ++a) {
            seen.w[2 * e + a] = data.landmarks[image][a][j];
            seen.slope[2 * e + a] = data.slopes[image][a][j];
        }
        seen.noise[3 * e] = V[4 * j];
        seen.noise[3 * e + 1] = V[4 * j + 1];
        seen.noise[3 * e + 2] = V[4 * j + 3];
        seen.noisy = seen.noisy || V[4 * j] > 0 || V[4 * j + 3] > 0;
    }
}

void find_likelihood(const PosteriorData& data, const Observed& seen, const Pack& pack,
                     const LaneView& view, const Lanes* belief, bool by_others,
                     const LikelihoodSpace& space, Likelihood& found, Lanes* next) {
    const long N = 2 * seen.m;
    const Lanes shrink = exponential(-view.log_scale);
    centre(seen, pack, view, shrink, space);
    fill_covariance(seen, pack, shrink * shrink, belief, space);
    const Lanes log_det = factorise(N, space);
    invert(N, space);
    found.surprise = solve(N, space);
    found.value = -0.5 * (found.surprise + log_det + static_cast<double>(N) * LOG_TWO_PI) -
                  static_cast<double>(N - 2) * view.log_scale;
    Lanes Z[9];
    pull_back(seen, pack, view, space, Z);
    differentiate(seen, view, shrink * shrink, belief, Z, space, found);
    believe(data, seen, view, shrink * shrink, belief, by_others, space, found, next);
}

}  // namespace shapefit::SHAPEFIT_LEVEL
