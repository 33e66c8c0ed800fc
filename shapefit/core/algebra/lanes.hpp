// Vectors of doubles as wide as the instruction set has them.
#pragma once

#include "scalar.hpp"

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
[[gnu::always_inline]] inline double sum(Lanes x) {
    double total = 0;
    for (int lane = 0; lane < WIDTH; ++lane) total += x[lane];
    return total;
}

[[gnu::always_inline]] inline Lanes all(double x) { return Lanes{} + x; }
[[gnu::always_inline]] inline Lanes root(Lanes x) {
    for (int lane = 0; lane < WIDTH; ++lane) x[lane] = ::sqrt(x[lane]);
    return x;
}
[[gnu::always_inline]] inline Lanes larger(Lanes a, Lanes b) { return a > b ? a : b; }
[[gnu::always_inline]] inline Lanes magnitude(Lanes x) { return x < 0 ? -x : x; }
[[gnu::always_inline]] inline Lanes square(Lanes x) { return x * x; }

}  // namespace shapefit::SHAPEFIT_LEVEL
