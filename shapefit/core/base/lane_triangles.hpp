// Cholesky factors S = L L^T of many matrices side by side, one a lane, their inverses
// L^-1 and products with these. Lower triangles in tiles of 4 rows and columns, whose
// sums of products stay in registers.
#pragma once

#include "lanes.hpp"

namespace shapefit {

constexpr Index TILE = 4;
constexpr double MIN_PIVOT = 1e-12;  // smaller ones are lifted to it
// n, up to the next multiple of TILE.
constexpr Index tiled(Index n) { return (n + TILE - 1) / TILE * TILE; }

// A lower triangular matrix of n rows, a multiple of TILE, stored row after row; the
// tiles on the diagonal are whole.
template <class Lanes>
struct Triangle {
    // How many entries n rows have.
    static constexpr Index size(Index n) { return n * (n + TILE) / 2; }

    // Where row i begins.
    [[gnu::always_inline]] Lanes* operator[](Index i) const {
        const Index tile = i / TILE;
        return data + TILE * (tile + 1) * (TILE * tile / 2 + i % TILE);
    }

    Lanes* data;
};

// sums_rc += sum_k a(k, r) b(k, c) for first <= k < last.
template <class Lanes, int columns, class A, class B>
[[gnu::always_inline]] inline void add_products(Lanes (&sums)[TILE][columns],
                                                Index first, Index last, const A& a,
                                                const B& b) {
    for (Index k = first; k < last; ++k) {
        Lanes x[TILE], y[columns];
#pragma GCC unroll 4
        for (int r = 0; r < TILE; ++r) x[r] = a(k, r);
#pragma GCC unroll 4
        for (int c = 0; c < columns; ++c) y[c] = b(k, c);
#pragma GCC unroll 4
        for (int r = 0; r < TILE; ++r)
#pragma GCC unroll 4
            for (int c = 0; c < columns; ++c) sums[r][c] += x[r] * y[c];
    }
}

template <class Lanes>
using Tile = Lanes[TILE][TILE];

// X <- (X - sums) L^-T for a tile X, its rows at x, left or below of a tile L on the
// diagonal; reciprocal_c = 1 / L_cc. `sums` is overwritten.
template <class Lanes>
[[gnu::always_inline]] inline void solve_tile(Lanes* const* x, Tile<Lanes>& sums,
                                              const Lanes* const* L,
                                              const Lanes* reciprocal) {
#pragma GCC unroll 4
    for (int c = 0; c < TILE; ++c)
#pragma GCC unroll 4
        for (int r = 0; r < TILE; ++r) {
            const Lanes solved = (x[r][c] - sums[r][c]) * reciprocal[c];
            x[r][c] = solved;
#pragma GCC unroll 4
            for (int e = c + 1; e < TILE; ++e) sums[r][e] += solved * L[e][c];
        }
}

// X <- L with X - sums = L L^T for a tile X on the diagonal, its rows at x, and
// reciprocal_c = 1 / L_cc; returns log det (X - sums). `sums` is overwritten.
template <class Lanes>
[[gnu::always_inline]] inline Lanes factorise_tile(Lanes* const* x, Tile<Lanes>& sums,
                                                   Lanes* reciprocal) {
    Lanes product = all<Lanes>(1.0);
#pragma GCC unroll 4
    for (int c = 0; c < TILE; ++c) {
        const Lanes pivot = larger(x[c][c] - sums[c][c], all<Lanes>(MIN_PIVOT));
        reciprocal[c] = 1.0 / root(pivot);
        product *= pivot;
        x[c][c] = pivot * reciprocal[c];
#pragma GCC unroll 4
        for (int r = c + 1; r < TILE; ++r) {
            x[c][r] = Lanes{};
            x[r][c] = (x[r][c] - sums[r][c]) * reciprocal[c];
#pragma GCC unroll 4
            for (int e = c + 1; e <= r; ++e) sums[r][e] += x[r][c] * x[e][c];
        }
    }
    return logarithm(product);
}

// X <- -L^-1 X for a tile X and a tile L on the diagonal, its rows at L; reciprocal_r =
// 1 / L_rr.
template <class Lanes>
[[gnu::always_inline]] inline void solve_back(Tile<Lanes>& X, Lanes* const* L,
                                              const Lanes* reciprocal) {
#pragma GCC unroll 4
    for (int r = 0; r < TILE; ++r)
#pragma GCC unroll 4
        for (int c = 0; c < TILE; ++c) {
            Lanes rest = X[r][c];
#pragma GCC unroll 4
            for (int e = 0; e < r; ++e) rest += L[r][e] * X[e][c];
            X[r][c] = -rest * reciprocal[r];
        }
}

// S <- L with S = L L^T, zeros above the diagonal in its tiles, and reciprocal_i = 1 /
// L_ii; returns log det S.
template <class Lanes>
Lanes factorise(Index n, Triangle<Lanes> S, Lanes* reciprocal) {
    Lanes log_det = {};
    for (Index i = 0; i < n; i += TILE)
        for (Index j = 0; j <= i; j += TILE) {
            Lanes* a[TILE] = {S[i], S[i + 1], S[i + 2], S[i + 3]};
            Lanes* b[TILE] = {S[j], S[j + 1], S[j + 2], S[j + 3]};
            Tile<Lanes> sums = {};
            add_products(
                sums, 0, j, [=](Index k, int r) { return a[r][k]; },
                [=](Index k, int c) { return b[c][k]; });
            for (int r = 0; r < TILE; ++r) {
                a[r] += j;
                b[r] += j;
            }
            if (j < i) solve_tile(a, sums, b, reciprocal + j);
            else log_det += factorise_tile(a, sums, reciprocal + i);
        }
    return log_det;
}

// L <- L^-1, given reciprocal_i = 1 / L_ii.
template <class Lanes>
void invert(Index n, Triangle<Lanes> L, const Lanes* reciprocal) {
    for (Index i = 0; i < n; i += TILE) {
        Lanes* a[TILE] = {L[i], L[i + 1], L[i + 2], L[i + 3]};
        Lanes* diagonal[TILE] = {a[0] + i, a[1] + i, a[2] + i, a[3] + i};
        for (Index j = 0; j <= i; j += TILE) {
            Tile<Lanes> sums = {};
            add_products(
                sums, j, i, [=](Index k, int r) { return a[r][k]; },
                [=](Index k, int c) { return L[k][j + c]; });
            if (j == i)
                for (int r = 0; r < TILE; ++r) sums[r][r] = all<Lanes>(-1.0);
            solve_back(sums, diagonal, reciprocal + i);
#pragma GCC unroll 4
            for (int r = 0; r < TILE; ++r)
#pragma GCC unroll 4
                for (int c = 0; c < TILE; ++c) a[r][j + c] = sums[r][c];
        }
    }
}

// out_v = M x_v for `count` vectors x_v of n numbers, one after another in memory.
template <int count, class Lanes>
[[gnu::always_inline]] inline void multiply(Index n, Triangle<Lanes> M, const Lanes* x,
                                            Lanes* __restrict out) {
    for (Index i = 0; i < n; i += TILE) {
        Lanes sums[TILE][count] = {};
        add_products(
            sums, 0, i + TILE, [&](Index k, int r) { return M[i + r][k]; },
            [&](Index k, int v) { return x[v * n + k]; });
        for (int r = 0; r < TILE; ++r)
            for (int v = 0; v < count; ++v) out[v * n + i + r] = sums[r][v];
    }
}

// out_v = M^T x_v for `count` vectors x_v of n numbers, one after another in memory.
template <int count, class Lanes>
[[gnu::always_inline]] inline void multiply_transposed(Index n, Triangle<Lanes> M,
                                                       const Lanes* x,
                                                       Lanes* __restrict out) {
    for (Index i = 0; i < n; i += TILE) {
        Lanes sums[TILE][count] = {};
        add_products(
            sums, i, n, [&](Index k, int r) { return M[k][i + r]; },
            [&](Index k, int v) { return x[v * n + k]; });
        for (int r = 0; r < TILE; ++r)
            for (int v = 0; v < count; ++v) out[v * n + i + r] = sums[r][v];
    }
}

}  // namespace shapefit
