// log and exp of lanes.
#pragma once

#include "exponential.hpp"
#include "lanes.hpp"
#include "logarithm.hpp"

namespace shapefit {

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
