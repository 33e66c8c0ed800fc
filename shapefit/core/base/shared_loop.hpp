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

// Multiplications from which on a loop is shared, about 0.2 ms of one core: to wake
// another thread and to wait for it takes 0.02 to 0.05 ms.
constexpr double MIN_SHARED = 3e6;

// Call run(part) for parts 0 .. count - 1, which take so many multiplications together:
// here, or shared out where that is worth it.
template <class Run>
void share_out(Index count, double multiplications, const Run& run) {
    if (count > 1 && multiplications >= MIN_SHARED) {
        const auto body = [](const void* data, Index part) {
            (*static_cast<const Run*>(data))(part);
        };
        run_shared({body, &run, count});
    } else {
        for (Index part = 0; part < count; ++part) run(part);
    }
}

}  // namespace shapefit
