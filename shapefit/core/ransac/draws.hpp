// Landmarks drawn at random: the same numbers on every machine for the same seed.
#pragma once

#include <stdint.h>

namespace shapefit {

constexpr int TRIPLE = 3;

struct Triple {
    long index[TRIPLE];
};

// An integer of 0..m-1 and the next state: SplitMix64 of Steele, Lea and Flood (2014).
inline long draw_below(uint64_t& state, long m) {
    state += 0x9E3779B97F4A7C15u;
    uint64_t z = state;
    z = (z ^ (z >> 30)) * 0xBF58476D1CE4E5B9u;
    z = (z ^ (z >> 27)) * 0x94D049BB133111EBu;
    z ^= z >> 31;
    return static_cast<long>(((z >> 32) * static_cast<uint64_t>(m)) >> 32);
}

// Three different integers of 0..m-1, m >= 3, all ordered triples equally likely.
inline Triple draw_triple(uint64_t& state, long m) {
    const long i = draw_below(state, m);
    long j = draw_below(state, m - 1), k = draw_below(state, m - 2);
    if (j >= i) ++j;
    const long low = i < j ? i : j, high = i < j ? j : i;
    if (k >= low) ++k;
    if (k >= high) ++k;
    return {{i, j, k}};
}

}  // namespace shapefit
