#include "lane_triangles.hpp"

#include "lane_functions.hpp"

namespace shapefit {
namespace {

constexpr double LEAST_PIVOT = 1e-12;

template <class Lanes>
using Tile = Lanes[TILE][TILE];

// X <- (X - sums) L^-T for a tile X beside a tile L on the diagonal.
template <class Lanes>
[[gnu::always_inline]] inline void solve_tile(Lanes* const* x, Tile<Lanes>& sums, const Lanes* const* L,
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

// The Cholesky factor of a tile less sums; returns log det.
template <class Lanes>
[[gnu::always_inline]] inline Lanes factorise_tile(Lanes* const* x, Tile<Lanes>& sums, Lanes* reciprocal) {
    Lanes product = all<Lanes>(1.0);
#pragma GCC unroll 4
    for (int c = 0; c < TILE; ++c) {
        const Lanes pivot = larger(x[c][c] - sums[c][c], all<Lanes>(LEAST_PIVOT));
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

// X <- -L^-1 X for the sums X beside a tile L on the diagonal.
template <class Lanes>
[[gnu::always_inline]] inline void solve_back(Tile<Lanes>& X, Lanes* const* L, const Lanes* reciprocal) {
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

}  // namespace

template <class Lanes>
Lanes factorise(long n, Triangle<Lanes> S, Lanes* reciprocal) {
    Lanes log_det = {};
    for (long i = 0; i < n; i += TILE)
        for (long j = 0; j <= i; j += TILE) {
            Lanes *a[TILE] = {S[i], S[i + 1], S[i + 2], S[i + 3]};
            Lanes *b[TILE] = {S[j], S[j + 1], S[j + 2], S[j + 3]};
            Tile<Lanes> sums = {};
            add_products(sums, 0, j, [=](long k, int r) { return a[r][k]; },
                         [=](long k, int c) { return b[c][k]; });
            for (int r = 0; r < TILE; ++r) {
                a[r] += j;
                b[r] += j;
            }
            if (j < i)
                solve_tile(a, sums, b, reciprocal + j);
            else
                log_det += factorise_tile(a, sums, reciprocal + i);
        }
    return log_det;
}

template <class Lanes>
void invert(long n, Triangle<Lanes> L, const Lanes* reciprocal) {
    for (long i = 0; i < n; i += TILE) {
        Lanes *a[TILE] = {L[i], L[i + 1], L[i + 2], L[i + 3]};
        Lanes* diagonal[TILE] = {a[0] + i, a[1] + i, a[2] + i, a[3] + i};
        for (long j = 0; j <= i; j += TILE) {
            Tile<Lanes> sums = {};
            add_products(sums, j, i, [=](long k, int r) { return a[r][k]; },
                         [=](long k, int c) { return L[k][j + c]; });
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

template Doubles factorise(long, Triangle<Doubles>, Doubles*);
template Singles factorise(long, Triangle<Singles>, Singles*);
template void invert(long, Triangle<Doubles>, const Doubles*);
template void invert(long, Triangle<Singles>, const Singles*);

}  // namespace shapefit
