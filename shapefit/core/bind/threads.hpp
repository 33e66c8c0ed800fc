// The images of a call, shared out among threads.
#pragma once

#include <condition_variable>
#include <exception>
#include <mutex>
#include <thread>
#include <vector>

#include "interrupt.hpp"

namespace shapefit {

// A kernel with its data.
struct Work {
    void (*kernel)(const void* data, Range);
    const void* data;

    // Call the kernel on a range of images.
    void operator()(Range range) const { kernel(data, range); }
};

// The calling thread and its helpers take ranges in turn until none is left. A helper
// that finds no memory gives its range back and leaves: a kernel that does a range
// again writes all of it again.
class Team {
  public:
    // For ranges of `step` images that cover images 0 .. count - 1.
    Team(const Work& work, Index count, Index step)
        : work_(work), count_(count), step_(step) {}

    // Call the kernel on all ranges, on so many threads or as many as the system
    // allows. The first exception of a thread is thrown again, after all have ended.
    void run(Index threads);

  private:
    // Each is explained in threads.cpp.
    void hire(Index helpers);
    void lead();
    void help();
    void begin();
    bool take(Range& range);
    bool await_helpers();
    void give_back(Range range);
    void fail();
    void leave();

    const Work& work_;
    const Index count_, step_;
    KernelCall call_;
    std::mutex guard_;  // of all that follows
    std::condition_variable changed_;
    Index next_ = 0, helpers_ = 0;
    Index begun_ = 0;  // helpers that have all that libc and C++ need of memory
    std::vector<Range> returned_;
    std::vector<std::thread> threads_;
    std::exception_ptr failure_;
};

// Call the kernel on ranges of whole blocks that cover images 0 .. count - 1, on
// several threads; `threads` = 0 means one per core.
void run_blocks(const Work& work, Index count, int threads);

}  // namespace shapefit
