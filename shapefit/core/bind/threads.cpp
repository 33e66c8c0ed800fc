#include "threads.hpp"

#include <algorithm>
#include <new>
#include <system_error>

namespace shapefit {
namespace {

// At most so many blocks at a time: what a kernel sets up is spent on more images.
constexpr Index MAX_BLOCKS = 8;

// What is free before a thread is made, in bytes: its stack, and more. Where a new
// thread finds no memory for its thread-local data, libc ends the process.
constexpr size_t MEMORY_OF_A_THREAD = 64 << 20;

// Whether MEMORY_OF_A_THREAD is free.
bool has_memory_for_a_thread() {
    void* memory = ::operator new(MEMORY_OF_A_THREAD, std::nothrow);
    ::operator delete(memory);
    return memory != nullptr;
}

}  // namespace

void run_blocks(const Work& work, Index count, int threads) {
    const Index blocks = (count + IMAGES_PER_BLOCK - 1) / IMAGES_PER_BLOCK;
    const Index cores = std::max(1u, std::thread::hardware_concurrency());
    const Index wanted = std::min<Index>(threads > 0 ? threads : cores, blocks);
    const Index step =
        std::clamp<Index>(blocks / std::max<Index>(1, 8 * wanted), 1, MAX_BLOCKS) *
        IMAGES_PER_BLOCK;
    Team(work, count, step).run(wanted);
}

void Team::run(Index threads) {
    hire(threads - 1);
    try {
        lead();
    } catch (...) {
        fail();
    }
    for (std::thread& thread : threads_) thread.join();
    if (failure_) std::rethrow_exception(failure_);
}

// Start so many helper threads one after another, as long as there is memory for one
// more.
void Team::hire(Index helpers) {
    threads_.reserve(std::max<Index>(0, helpers));
    returned_.reserve(threads_.capacity());
    for (Index helper = 1; helper <= helpers && has_memory_for_a_thread(); ++helper) {
        std::unique_lock<std::mutex> lock(guard_);
        try {
            threads_.emplace_back(&Team::help, this);
        } catch (const std::system_error&) {
            return;  // the system has no more threads
        }
        ++helpers_;
        changed_.wait(lock, [&] { return begun_ == helper; });
    }
}

// Call the kernel on ranges, on the calling thread, until none is left and all helpers
// are done.
void Team::lead() {
    const Watch watch(call_, true);
    Range range;
    do {
        while (take(range)) work_(range);
    } while (await_helpers());
}

// Call the kernel on ranges, on another thread, until none is left; without memory it
// gives its range back.
void Team::help() {
    const Watch watch(call_, false);
    begin();
    Range range;
    try {
        while (take(range)) work_(range);
    } catch (const std::bad_alloc&) {
        give_back(range);
    } catch (...) {
        fail();
    }
    leave();
}

// Note that a helper has begun, with all memory that it needs.
void Team::begin() {
    std::uncaught_exceptions();  // has memory of its own in each thread, taken here
    const std::lock_guard<std::mutex> lock(guard_);
    ++begun_;
    changed_.notify_all();
}

// Take the next range; false where none is left, or the call has failed.
bool Team::take(Range& range) {
    const std::lock_guard<std::mutex> lock(guard_);
    if (failure_) return false;
    if (!returned_.empty()) {
        range = returned_.back();
        returned_.pop_back();
        return true;
    }
    if (next_ >= count_) return false;
    range = {next_, std::min(next_ + step_, count_)};
    next_ = range.last;
    return true;
}

// Wait until all helpers have left or one gives a range back; returns whether one did.
bool Team::await_helpers() {
    std::unique_lock<std::mutex> lock(guard_);
    while (helpers_ > 0 && returned_.empty() && !failure_) {
        changed_.wait_for(lock, BETWEEN_LOOKS);
        lock.unlock();
        call_.check_signals();
        lock.lock();
    }
    return !returned_.empty() && !failure_;
}

// Leave a range that was taken to another thread.
void Team::give_back(Range range) {
    const std::lock_guard<std::mutex> lock(guard_);
    returned_.push_back(range);
}

// End the call with the exception that is being handled.
void Team::fail() {
    const std::lock_guard<std::mutex> lock(guard_);
    if (!failure_) failure_ = std::current_exception();
    call_.end();
}

// Note that a helper has ended.
void Team::leave() {
    const std::lock_guard<std::mutex> lock(guard_);
    --helpers_;
    changed_.notify_all();
}

}  // namespace shapefit
