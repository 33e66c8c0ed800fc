// A loop within one image, shared out among threads that have nothing else to do.
#pragma once

#include "index.hpp"

namespace shapefit {

// Parts 0 .. count - 1, which threads take in any order. Each part writes numbers that
// no other reads or writes, and allocates nothing: so no bit depends on who takes it.
struct SharedLoop {
    void (*body)(const void* data, Index part);
    const void* data;
    Index count;
};

// Run all parts of a loop, on this thread and on those of the call of the kernel that
// have nothing else to do; bind/threads.cpp defines it, outside the code of any
// instruction set.
void run_shared(const SharedLoop& loop);

// Multiplications from which on a loop is shared: 0.12 ms of one core with AVX-512,
// 0.33 with AVX2, 0.7 without. To wake another thread and wait for it takes 0.01 ms, to
// start one, once a call, 0.02. A third of this limit gains little.
constexpr double MIN_SHARED = 3e6;

// Call run(from, end) for ranges that cover first <= i < last and take so many
// multiplications together: for all at once, or for `step` at a time, shared out, where
// that is worth it.
template <class Run>
void share_out(Index first, Index last, Index step, double multiplications,
               const Run& run) {
    if (multiplications < MIN_SHARED) return run(first, last);
    const auto run_part = [&](Index part) {
        const Index from = first + part * step;
        run(from, from + step < last ? from + step : last);
    };
    using Part = decltype(run_part);
    const auto body = [](const void* data, Index part) {
        (*static_cast<const Part*>(data))(part);
    };
    run_shared({body, &run_part, (last - first + step - 1) / step});
}

}  // namespace shapefit
