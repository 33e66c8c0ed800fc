// Loops over contiguous numbers that the compiler turns into vector instructions.
#pragma once

#include "scalar.hpp"

namespace shapefit::SHAPEFIT_LEVEL {

[[gnu::always_inline]] inline double dot(const double* a, const double* b, long n) {
    double total = 0;
    for (long i = 0; i < n; ++i) total += a[i] * b[i];
    return total;
}

// y += factor x; x and y are disjoint.
[[gnu::always_inline]] inline void add_to(double* __restrict y, double factor,
                                          const double* __restrict x, long n) {
    for (long i = 0; i < n; ++i) y[i] += factor * x[i];
}

// y -= sum_e x_e row_(index_e), e < m, for rows of n numbers with the given stride.
inline void subtract_mixture(double* __restrict y, const double* __restrict x,
                             const long* __restrict index, long m, const double* __restrict rows,
                             long stride, long n) {
    long e = 0;
    for (; e + 4 <= m; e += 4) {
        const double *r0 = rows + index[e] * stride, *r1 = rows + index[e + 1] * stride;
        const double *r2 = rows + index[e + 2] * stride, *r3 = rows + index[e + 3] * stride;
        const double x0 = x[e], x1 = x[e + 1], x2 = x[e + 2], x3 = x[e + 3];
        for (long i = 0; i < n; ++i) y[i] -= x0 * r0[i] + x1 * r1[i] + x2 * r2[i] + x3 * r3[i];
    }
    for (; e < m; ++e) add_to(y, -x[e], rows + index[e] * stride, n);
}

// The largest of n numbers, -infinity where there are none; nan never is.
inline double largest_of(const double* x, long n) {
    constexpr long LANES = 8;
    double best[LANES];
    for (long lane = 0; lane < LANES; ++lane) best[lane] = -INFINITE;
    long i = 0;
    for (; i + LANES <= n; i += LANES)
        for (long lane = 0; lane < LANES; ++lane) best[lane] = larger(x[i + lane], best[lane]);
    for (; i < n; ++i) best[0] = larger(x[i], best[0]);
    for (long lane = 1; lane < LANES; ++lane) best[0] = larger(best[lane], best[0]);
    return best[0];
}

inline double smallest_of(const double* x, long n) {
    constexpr long LANES = 8;
    double best[LANES];
    for (long lane = 0; lane < LANES; ++lane) best[lane] = INFINITE;
    long i = 0;
    for (; i + LANES <= n; i += LANES)
        for (long lane = 0; lane < LANES; ++lane) best[lane] = smaller(x[i + lane], best[lane]);
    for (; i < n; ++i) best[0] = smaller(x[i], best[0]);
    for (long lane = 1; lane < LANES; ++lane) best[0] = smaller(best[lane], best[0]);
    return best[0];
}

// The first place of `value` among n numbers; n where it is not there.
inline long place_of(double value, const double* x, long n) {
    long i = 0;
    while (i < n && x[i] != value) ++i;
    return i;
}

}  // namespace shapefit::SHAPEFIT_LEVEL
