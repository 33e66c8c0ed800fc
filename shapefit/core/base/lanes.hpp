// Vectors of doubles as wide as the instruction set has them.
#pragma once

#include <type_traits>

#include "scalar.hpp"

namespace shapefit {

#if defined(__AVX512F__)
constexpr int WIDTH = 8;
#elif defined(__AVX__)
constexpr int WIDTH = 4;
#else
constexpr int WIDTH = 2;
#endif

typedef double Doubles __attribute__((vector_size(WIDTH * sizeof(double))));
// Twice as many in single precision.
typedef float Singles __attribute__((vector_size(WIDTH * sizeof(double))));
typedef double LooseDoubles
    __attribute__((vector_size(WIDTH * sizeof(double)), aligned(sizeof(double)), may_alias));

// Rows are padded with zeros to this many numbers, whatever the width.
constexpr long PADDING = 8;
constexpr long padded(long n) { return (n + PADDING - 1) / PADDING * PADDING; }

inline Doubles load(const double* x) {
    return *reinterpret_cast<const LooseDoubles*>(x);
}
inline void store(double* x, Doubles value) {
    *reinterpret_cast<LooseDoubles*>(x) = value;
}
// What <immintrin.h> names _mm_sqrt_pd and so on, without the seconds that it takes to read.
inline Doubles root(Doubles x) {
#if defined(__AVX512F__) && !defined(__clang__)
    return __builtin_ia32_sqrtpd512_mask(x, x, -1, 4);  // all lanes, rounded as elsewhere
#elif defined(__AVX__) && !defined(__clang__)
    return __builtin_ia32_sqrtpd256(x);
#elif defined(__SSE2__) && !defined(__clang__)
    return __builtin_ia32_sqrtpd(x);
#else
    for (int lane = 0; lane < WIDTH; ++lane) x[lane] = root(x[lane]);
    return x;
#endif
}
inline Singles root(Singles x) {
#if defined(__AVX512F__) && !defined(__clang__)
    return __builtin_ia32_sqrtps512_mask(x, x, -1, 4);
#elif defined(__AVX__) && !defined(__clang__)
    return __builtin_ia32_sqrtps256(x);
#elif defined(__SSE2__) && !defined(__clang__)
    return __builtin_ia32_sqrtps(x);
#else
    for (int lane = 0; lane < 2 * WIDTH; ++lane) x[lane] = __builtin_sqrtf(x[lane]);
    return x;
#endif
}
inline Doubles larger(Doubles a, Doubles b) { return a > b ? a : b; }
inline Doubles smaller(Doubles a, Doubles b) { return a < b ? a : b; }
inline Singles larger(Singles a, Singles b) { return a > b ? a : b; }
inline Singles smaller(Singles a, Singles b) { return a < b ? a : b; }
inline Doubles magnitude(Doubles x) { return x < 0.0 ? -x : x; }
// All lanes alike.
inline Doubles all(double x) { return Doubles{} + x; }
// For functions of lanes of either precision: what a lane holds, how many there are, all alike.
template <class Lanes>
using Number = std::remove_cvref_t<decltype(Lanes{}[0])>;
template <class Lanes>
constexpr int width = sizeof(Lanes) / sizeof(Number<Lanes>);
template <class Lanes>
inline Lanes all(double x) {
    return Lanes{} + static_cast<Number<Lanes>>(x);
}
template <class Lanes>
inline double largest(Lanes x) {
    double result = x[0];
    for (int lane = 1; lane < width<Lanes>; ++lane) result = larger(result, x[lane]);
    return result;
}
inline double sum(Doubles x) {
    double total = 0;
    for (int lane = 0; lane < WIDTH; ++lane) total += x[lane];
    return total;
}

inline Doubles square(Doubles x) { return x * x; }

}  // namespace shapefit
