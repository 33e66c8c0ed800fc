// A kernel over the stretches of a batch, on several threads.
#pragma once

#include <algorithm>
#include <atomic>
#include <exception>
#include <mutex>
#include <thread>
#include <vector>

#include "../base/memory.hpp"

namespace shapefit {

// At most so many stretches at a time: what a kernel sets up is spent on more images.
constexpr long MOST_STRETCHES = 8;

// Call work(range) on whole stretches that cover 0..count; `threads` = 0 means one per core. The
// first exception of a thread is raised again, after all have ended.
template <class Work>
void run_stretches(long count, int threads, const Work& work) {
    const long stretches = (count + STRETCH - 1) / STRETCH;
    const long cores = std::max(1u, std::thread::hardware_concurrency());
    const long wanted = std::min<long>(threads > 0 ? threads : cores, stretches);
    const long step = std::clamp(stretches / std::max(1L, 8 * wanted), 1L, MOST_STRETCHES) * STRETCH;
    std::atomic<long> next{0};
    std::exception_ptr failure;
    std::mutex guard;
    const auto take_stretches = [&] {
        try {
            for (long first = next.fetch_add(step); first < count; first = next.fetch_add(step))
                work(Range{first, std::min(first + step, count)});
        } catch (...) {
            const std::lock_guard<std::mutex> lock(guard);
            if (!failure) failure = std::current_exception();
            next = count;
        }
    };
    std::vector<std::thread> others;
    for (long t = 1; t < wanted; ++t) others.emplace_back(take_stretches);
    take_stretches();
    for (std::thread& other : others) other.join();
    if (failure) std::rethrow_exception(failure);
}

}  // namespace shapefit
