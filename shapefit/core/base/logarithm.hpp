// log(1 + x) without a call, so that a loop over many x becomes vector instructions.
#pragma once

#include <stdint.h>

#include "scalar.hpp"
#include "views.hpp"

namespace shapefit {

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

}  // namespace shapefit
