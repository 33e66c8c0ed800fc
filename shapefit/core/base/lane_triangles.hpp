// Lower triangles of lanes, in tiles of 4 rows and columns whose sums of products stay in registers.
#pragma once

#include "lanes.hpp"

namespace shapefit {

constexpr long TILE = 4;
constexpr long tiled(long n) { return (n + TILE - 1) / TILE * TILE; }

// Of n rows, a multiple of TILE; the tiles on the diagonal are whole.
template <class Lanes>
struct Triangle {
    static constexpr long size(long n) { return n * (n + TILE) / 2; }

    [[gnu::always_inline]] Lanes* operator[](long i) const {
        const long tile = i / TILE;
        return data + TILE * (tile + 1) * (TILE * tile / 2 + i % TILE);
    }

    Lanes* data;
};

// sums_rc += sum_k a(k, r) b(k, c) for first <= k < last.
template <class Lanes, int columns, class A, class B>
[[gnu::always_inline]] inline void add_products(Lanes (&sums)[TILE][columns], long first, long last,
                                                const A& a, const B& b) {
    for (long k = first; k < last; ++k) {
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

// S = L L^T in place, zeros above the diagonal, with 1 / L_ii; returns log det S.
template <class Lanes>
Lanes factorise(long n, Triangle<Lanes> S, Lanes* reciprocal);

// L <- L^-1 in place.
template <class Lanes>
void invert(long n, Triangle<Lanes> L, const Lanes* reciprocal);

// out_v = M x_v for `count` vectors of n numbers, one after another.
template <int count, class Doubles>
[[gnu::always_inline]] inline void multiply(long n, Triangle<Doubles> M, const Doubles* x, Doubles* __restrict out) {
    for (long i = 0; i < n; i += TILE) {
        Doubles sums[TILE][count] = {};
        add_products(sums, 0, i + TILE, [&](long k, int r) { return M[i + r][k]; },
                     [&](long k, int v) { return x[v * n + k]; });
        for (int r = 0; r < TILE; ++r)
            for (int v = 0; v < count; ++v) out[v * n + i + r] = sums[r][v];
    }
}

// out_v = M^T x_v likewise.
template <int count, class Doubles>
[[gnu::always_inline]] inline void multiply_transposed(long n, Triangle<Doubles> M, const Doubles* x,
                                                       Doubles* __restrict out) {
    for (long i = 0; i < n; i += TILE) {
        Doubles sums[TILE][count] = {};
        add_products(sums, i, n, [&](long k, int r) { return M[k][i + r]; },
                     [&](long k, int v) { return x[v * n + k]; });
        for (int r = 0; r < TILE; ++r)
            for (int v = 0; v < count; ++v) out[v * n + i + r] = sums[r][v];
    }
}

}  // namespace shapefit
