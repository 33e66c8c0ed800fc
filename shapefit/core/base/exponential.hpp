// exp(x) without a call, so that a loop over many x becomes vector instructions.
#pragma once

#include <stdint.h>

#include "scalar.hpp"

namespace shapefit {

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

}  // namespace shapefit
