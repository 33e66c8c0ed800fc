// Functions of numbers, and of vectors of numbers as wide as the instruction set has
// them.
#pragma once

#include <stdint.h>

#include <type_traits>

#include "index.hpp"

namespace shapefit {

// The compiler knows them without <math.h>, which takes longer to read than most
// kernels.
constexpr double INFINITE = __builtin_huge_val();
constexpr double NOT_A_NUMBER = __builtin_nan("");
constexpr double TINY = 1e-300;  // in place of a zero divisor

// sqrt(x) and |x|.
inline double root(double x) { return __builtin_sqrt(x); }
inline double magnitude(double x) { return __builtin_fabs(x); }
// The functions of <math.h>.
inline double exp(double x) { return __builtin_exp(x); }
inline double log(double x) { return __builtin_log(x); }
inline double log1p(double x) { return __builtin_log1p(x); }
inline double sin(double x) { return __builtin_sin(x); }
inline double cos(double x) { return __builtin_cos(x); }
inline double copysign(double size, double sign) {
    return __builtin_copysign(size, sign);
}
// x^2, max(a, b), min(a, b), and the sign of x, 0 for 0.
inline double square(double x) { return x * x; }
inline double larger(double a, double b) { return a > b ? a : b; }
inline double smaller(double a, double b) { return a < b ? a : b; }
inline double sign_of(double x) { return x > 0 ? 1.0 : x < 0 ? -1.0 : 0.0; }
// Whether x is neither infinite nor nan.
inline bool is_finite(double x) { return magnitude(x) < INFINITE; }

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
typedef double LooseDoubles __attribute__((vector_size(WIDTH * sizeof(double)),
                                           aligned(sizeof(double)), may_alias));

// Rows are padded with zeros to this many numbers, whatever the width.
constexpr Index PADDING = 8;
// n, up to the next multiple of PADDING.
constexpr Index padded(Index n) { return (n + PADDING - 1) / PADDING * PADDING; }

// Load WIDTH numbers from any address, and store them there.
inline Doubles load(const double* x) {
    return *reinterpret_cast<const LooseDoubles*>(x);
}
inline void store(double* x, Doubles value) {
    *reinterpret_cast<LooseDoubles*>(x) = value;
}
// The square roots, lane by lane: what <immintrin.h> names _mm_sqrt_pd and so on,
// without the seconds that it takes to read.
inline Doubles root(Doubles x) {
#if defined(__AVX512F__) && !defined(__clang__)
    return __builtin_ia32_sqrtpd512_mask(x, x, -1,
                                         4);  // all lanes, rounded as elsewhere
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
// max(a, b), min(a, b) and |x|, lane by lane.
inline Doubles larger(Doubles a, Doubles b) { return a > b ? a : b; }
inline Doubles smaller(Doubles a, Doubles b) { return a < b ? a : b; }
inline Singles larger(Singles a, Singles b) { return a > b ? a : b; }
inline Singles smaller(Singles a, Singles b) { return a < b ? a : b; }
inline Doubles magnitude(Doubles x) { return x < 0.0 ? -x : x; }
// A vector with x in all lanes.
inline Doubles all(double x) { return Doubles{} + x; }
// For functions of lanes of either precision: the type of a lane, the number of lanes,
// and x in all of them.
template <class Lanes>
using Number = std::remove_cvref_t<decltype(Lanes{}[0])>;
template <class Lanes>
constexpr int width = sizeof(Lanes) / sizeof(Number<Lanes>);
template <class Lanes>
inline Lanes all(double x) {
    return Lanes{} + static_cast<Number<Lanes>>(x);
}
// The largest lane.
template <class Lanes>
inline double largest(Lanes x) {
    double result = x[0];
    for (int lane = 1; lane < width<Lanes>; ++lane) result = larger(result, x[lane]);
    return result;
}
// The sum of the lanes.
inline double sum(Doubles x) {
    double total = 0;
    for (int lane = 0; lane < WIDTH; ++lane) total += x[lane];
    return total;
}

// x^2, lane by lane.
inline Doubles square(Doubles x) { return x * x; }

// exp(x) without a call, so that a loop over many x becomes vector instructions: to a
// relative error of 1 + |x| roundings, for |x| < 700; its values there beyond.
//
// x = e log 2 + f with |f| <= log(2) / 2: then exp x = 2^e (1 + f + f^2 / 2! + ... +
// f^13 / 13!).
inline double power_of_e(double x) {
    x = larger(smaller(x, 700.0), -700.0);
    const double e = __builtin_floor(x * 0x1.71547652b82fep0 + 0.5);
    const double f = x - e * 0x1.62e42fefa39efp-1;
    constexpr double TERMS[] = {1.0,
                                1.0,
                                1.0 / 2,
                                1.0 / 6,
                                1.0 / 24,
                                1.0 / 120,
                                1.0 / 720,
                                1.0 / 5040,
                                1.0 / 40320,
                                1.0 / 362880,
                                1.0 / 3628800,
                                1.0 / 39916800,
                                1.0 / 479001600};
    double series = 1.0 / 6227020800;
#pragma GCC unroll 13
    for (int term = 13; term-- > 0;) series = series * f + TERMS[term];
    const uint64_t exponent = __builtin_bit_cast(uint64_t, e + (0x1p52 + 1023)) << 52;
    return series * __builtin_bit_cast(double, exponent);
}

// log(1 + x) without a call, so that a loop over many x becomes vector instructions:
// for finite x >= 0, to a relative error of a few roundings; nan for nan.
//
// 1 + x = 2^e (1 + f) with 1 + f in [0.7, 1.42), and e = 0, f = x without rounding for
// small x: then log(1 + f) = 2 atanh(s) = 2 s (1 + s^2 / 3 + s^4 / 5 + ...) at s = f /
// (2 + f), |s| < 0.172.
inline double log_of_one_plus(double x) {
    constexpr uint64_t HALF_ROOT = 0x3fe6a09e00000000;  // the bits of sqrt(1/2), nearly
    constexpr uint64_t WHOLE = 0x4330000000000000;      // those of 2^52
    const uint64_t bits = __builtin_bit_cast(uint64_t, 1.0 + x);
    const uint64_t exponent = (bits - HALF_ROOT) >> 52;
    const bool small = !(x >= 0.41);  // nan too, which stays
    const double mantissa = __builtin_bit_cast(double, bits - (exponent << 52));
    const double e =
        small ? 0.0 : __builtin_bit_cast(double, exponent | WHOLE) - 0x1p52;
    const double f = small ? x : mantissa - 1.0;
    const double s = f / (2.0 + f), z = s * s;
    double series = 1.0 / 19;
#pragma GCC unroll 8
    for (int odd = 17; odd > 1; odd -= 2) series = series * z + 1.0 / odd;
    return e * 0x1.62e42fefa39efp-1 + 2.0 * (s + s * z * series);
}

// exp, lane by lane.
template <class Lanes>
inline Lanes exponential(Lanes x) {
    for (int lane = 0; lane < width<Lanes>; ++lane) x[lane] = power_of_e(x[lane]);
    return x;
}

// log x, under the name that it has for lanes.
inline double logarithm(double x) { return log(x); }

// log x, lane by lane, for x > 2^-60.
template <class Lanes>
inline Lanes logarithm(Lanes x) {
    constexpr double GROWN = 0x1p60, LOG_GROWN = 60 * 0x1.62e42fefa39efp-1;
    for (int lane = 0; lane < width<Lanes>; ++lane)
        x[lane] = log_of_one_plus(x[lane] * GROWN - 1.0) - LOG_GROWN;
    return x;
}

}  // namespace shapefit
