// The images of a call, shared out among threads.
#pragma once

#include <condition_variable>
#include <exception>
#include <mutex>
#include <thread>
#include <vector>

#include "../base/shared_loop.hpp"
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
//
// A thread that finds no range left takes parts of the loops that others share, one
// loop at a time, until all ranges are done. It sleeps where there are none.
class Team {
  public:
    // For ranges of `step` images that cover images 0 .. count - 1, on at most so many
    // threads.
    Team(const Work& work, Index count, Index step, Index threads)
        : work_(work), count_(count), step_(step), most_helpers_(threads - 1) {}

    // Call the kernel on all ranges, on so many threads or as many as the system
    // allows. The first exception of a thread is thrown again, after all have ended.
    void run(Index threads);

    // Run all parts of a loop of one of the threads, on it and on those that have no
    // range; more helpers are hired for it.
    void share(const SharedLoop& loop);

  private:
    // Each is explained in threads.cpp.
    void hire(Index helpers);
    bool hire_one();
    void lead();
    void help();
    void begin();
    bool take(Range& range);
    void finish();
    bool await_ranges();
    bool post(const SharedLoop& loop);
    bool has_parts() const;
    void take_parts();
    void await_parts();
    void give_back(Range range);
    void fail();
    void join();

    const Work& work_;
    const Index count_, step_, most_helpers_;
    KernelCall call_;
    std::mutex hiring_;     // one thread hires at a time
    bool can_hire_ = true;  // no attempt has failed
    std::mutex guard_;      // of all that follows
    std::condition_variable changed_;
    Index hired_ = 0;
    Index begun_ = 0;  // helpers that have all that libc and C++ need of memory
    Index next_ = 0;
    Index running_ = 0;  // ranges that were taken and are not done
    std::vector<Range> returned_;
    const SharedLoop* loop_ = nullptr;
    Index next_part_ = 0;
    Index running_parts_ = 0;
    std::vector<std::thread> threads_;
    std::exception_ptr failure_;
};

// Call the kernel on ranges of whole blocks that cover images 0 .. count - 1, on
// several threads; `threads` = 0 means one per core.
void run_blocks(const Work& work, Index count, int threads);

}  // namespace shapefit
