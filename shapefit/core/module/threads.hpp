// A kernel over the stretches of a batch, on several threads.
#pragma once

#include <algorithm>
#include <atomic>
#include <exception>
#include <mutex>
#include <thread>
#include <vector>

#include "../algebra/views.hpp"

namespace shapefit {

// Images of one stretch may start from one another's solutions. Its length is fixed, so that no
// result depends on the number of threads, nor on how a file is cut into batches of whole stretches.
constexpr long STRETCH = 64;

// Call work(range) on stretches that cover 0..count; `threads` = 0 means one per core. The first
// exception of a thread is raised again, after all have ended.
template <class Work>
void run_stretches(long count, int threads, const Work& work) {
    const long stretches = (count + STRETCH - 1) / STRETCH;
    std::atomic<long> next{0};
    std::exception_ptr failure;
    std::mutex guard;
    const auto take_stretches = [&] {
        try {
            for (long s = next++; s < stretches; s = next++)
                work(Range{s * STRETCH, std::min((s + 1) * STRETCH, count)});
        } catch (...) {
            const std::lock_guard<std::mutex> lock(guard);
            if (!failure) failure = std::current_exception();
            next = stretches;
        }
    };
    const long cores = std::max(1u, std::thread::hardware_concurrency());
    const long wanted = std::min<long>(threads > 0 ? threads : cores, stretches);
    std::vector<std::thread> others;
    for (long t = 1; t < wanted; ++t) others.emplace_back(take_stretches);
    take_stretches();
    for (std::thread& other : others) other.join();
    if (failure) std::rethrow_exception(failure);
}

}  // namespace shapefit
