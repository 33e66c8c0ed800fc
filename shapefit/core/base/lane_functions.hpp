// log and exp, of numbers and of lanes.
#pragma once

#include <stdint.h>

#include "lanes.hpp"
#include "scalar.hpp"
#include "views.hpp"

namespace shapefit {

// exp(x) without a call, so that a loop over many x becomes vector instructions.

// exp(x) to a relative error of 1 + |x| roundings, for |x| < 700; its values there beyond.
//
// x = e log 2 + f with |f| <= log(2) / 2: then exp x = 2^e (1 + f + f^2 / 2! + ... + f^13 / 13!).
inline double power_of_e(double x) {
    x = larger(smaller(x, 700.0), -700.0);
    const double e = __builtin_floor(x * 0x1.71547652b82fep0 + 0.5);
    const double f = x - e * 0x1.62e42fefa39efp-1;
    double series = 1.0 / 6227020800;
    series = series * f + 1.0 / 479001600;
    series = series * f + 1.0 / 39916800;
    series = series * f + 1.0 / 3628800;
    series = series * f + 1.0 / 362880;
    series = series * f + 1.0 / 40320;
    series = series * f + 1.0 / 5040;
    series = series * f + 1.0 / 720;
    series = series * f + 1.0 / 120;
    series = series * f + 1.0 / 24;
    series = series * f + 1.0 / 6;
    series = series * f + 0.5;
    series = series * f + 1.0;
    series = series * f + 1.0;
    const uint64_t exponent = __builtin_bit_cast(uint64_t, e + (0x1p52 + 1023)) << 52;
    return series * __builtin_bit_cast(double, exponent);
}

// log(1 + x) without a call, so that a loop over many x becomes vector instructions.

// log(1 + x) for finite x >= 0, to a relative error of a few roundings; nan for nan.
//
// 1 + x = 2^e (1 + f) with 1 + f in [0.7, 1.42), and e = 0, f = x without rounding for small x:
// then log(1 + f) = 2 atanh(s) = 2 s (1 + s^2 / 3 + s^4 / 5 + ...) at s = f / (2 + f), |s| < 0.172.
inline double log_of_one_plus(double x) {
    constexpr uint64_t HALF_ROOT = 0x3fe6a09e00000000;  // the bits of sqrt(1/2), nearly
    constexpr uint64_t WHOLE = 0x4330000000000000;      // those of 2^52
    const uint64_t bits = __builtin_bit_cast(uint64_t, 1.0 + x);
    const uint64_t exponent = (bits - HALF_ROOT) >> 52;
    const bool small = !(x >= 0.41);  // nan too, which stays
    const double mantissa = __builtin_bit_cast(double, bits - (exponent << 52));
    const double e = small ? 0.0 : __builtin_bit_cast(double, exponent | WHOLE) - 0x1p52;
    const double f = small ? x : mantissa - 1.0;
    const double s = f / (2.0 + f), z = s * s;
    double series = 1.0 / 19;
    series = series * z + 1.0 / 17;
    series = series * z + 1.0 / 15;
    series = series * z + 1.0 / 13;
    series = series * z + 1.0 / 11;
    series = series * z + 1.0 / 9;
    series = series * z + 1.0 / 7;
    series = series * z + 1.0 / 5;
    series = series * z + 1.0 / 3;
    return e * 0x1.62e42fefa39efp-1 + 2.0 * (s + s * z * series);
}

// log and exp of lanes.

template <class Lanes>
inline Lanes exponential(Lanes x) {
    for (int lane = 0; lane < width<Lanes>; ++lane) x[lane] = power_of_e(x[lane]);
    return x;
}

// log x for x > 2^-60.
template <class Lanes>
inline Lanes logarithm(Lanes x) {
    constexpr double GROWN = 0x1p60, LOG_GROWN = 60 * 0x1.62e42fefa39efp-1;
    for (int lane = 0; lane < width<Lanes>; ++lane)
        x[lane] = log_of_one_plus(x[lane] * GROWN - 1.0) - LOG_GROWN;
    return x;
}

}  // namespace shapefit
