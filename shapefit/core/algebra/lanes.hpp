// Vectors of doubles as wide as the instruction set has them.
#pragma once

#include "scalar.hpp"

#if defined(__SSE2__)
#include <immintrin.h>
#endif

namespace shapefit::SHAPEFIT_LEVEL {

#if defined(__AVX512F__)
constexpr int WIDTH = 8;
#elif defined(__AVX__)
constexpr int WIDTH = 4;
#else
constexpr int WIDTH = 2;
#endif

typedef double Lanes __attribute__((vector_size(WIDTH * sizeof(double))));
typedef double LooseLanes
    __attribute__((vector_size(WIDTH * sizeof(double)), aligned(sizeof(double)), may_alias));

// Rows are padded with zeros to this many numbers, whatever the width.
constexpr long PADDING = 8;
constexpr long padded(long n) { return (n + PADDING - 1) / PADDING * PADDING; }

[[gnu::always_inline]] inline Lanes load(const double* x) {
    return *reinterpret_cast<const LooseLanes*>(x);
}
[[gnu::always_inline]] inline void store(double* x, Lanes value) {
    *reinterpret_cast<LooseLanes*>(x) = value;
}
[[gnu::always_inline]] inline Lanes root(Lanes x) {
#if defined(__AVX512F__)
    return _mm512_sqrt_pd(x);
#elif defined(__AVX__)
    return _mm256_sqrt_pd(x);
#elif defined(__SSE2__)
    return _mm_sqrt_pd(x);
#else
    for (int lane = 0; lane < WIDTH; ++lane) x[lane] = root(x[lane]);
    return x;
#endif
}
[[gnu::always_inline]] inline Lanes larger(Lanes a, Lanes b) { return a > b ? a : b; }
[[gnu::always_inline]] inline Lanes smaller(Lanes a, Lanes b) { return a < b ? a : b; }
[[gnu::always_inline]] inline Lanes magnitude(Lanes x) { return x < 0.0 ? -x : x; }
// All lanes alike.
[[gnu::always_inline]] inline Lanes all(double x) { return Lanes{} + x; }
[[gnu::always_inline]] inline double largest(Lanes x) {
    double result = x[0];
    for (int lane = 1; lane < WIDTH; ++lane) result = larger(result, x[lane]);
    return result;
}
[[gnu::always_inline]] inline double sum(Lanes x) {
    double total = 0;
    for (int lane = 0; lane < WIDTH; ++lane) total += x[lane];
    return total;
}

[[gnu::always_inline]] inline Lanes square(Lanes x) { return x * x; }

}  // namespace shapefit::SHAPEFIT_LEVEL
