#include "threads.hpp"

#include <algorithm>
#include <new>

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

thread_local Team* team = nullptr;  // of this thread

// While it lives, the loops of this thread are shared by the team.
class Membership {
  public:
    explicit Membership(Team& joined) : before_(team) { team = &joined; }
    ~Membership() { team = before_; }
    Membership(const Membership&) = delete;
    Membership& operator=(const Membership&) = delete;

  private:
    Team* const before_;
};

// Run all parts of a loop on this thread.
void run_alone(const SharedLoop& loop) {
    for (Index part = 0; part < loop.count; ++part) loop.body(loop.data, part);
}

}  // namespace

void run_blocks(const Work& work, Index count, int threads) {
    const Index blocks = (count + IMAGES_PER_BLOCK - 1) / IMAGES_PER_BLOCK;
    const Index cores = std::max(1u, std::thread::hardware_concurrency());
    const Index most = threads > 0 ? threads : cores;
    const Index wanted = std::min<Index>(most, blocks);
    const Index step =
        std::clamp<Index>(blocks / std::max<Index>(1, 8 * wanted), 1, MAX_BLOCKS) *
        IMAGES_PER_BLOCK;
    Team(work, count, step, most).run(wanted);
}

void run_shared(const SharedLoop& loop) {
    if (team) team->share(loop);
    else run_alone(loop);
}

void Team::run(Index threads) {
    threads_.reserve(most_helpers_);
    returned_.reserve(most_helpers_);
    hire(threads - 1);
    try {
        lead();
    } catch (...) {
        fail();
    }
    join();
    if (failure_) std::rethrow_exception(failure_);
}

// Start helper threads one after another until there have been so many, as long as
// there is memory for one more.
void Team::hire(Index helpers) {
    const std::lock_guard<std::mutex> one_at_a_time(hiring_);
    while (can_hire_ && hired_ < std::min(helpers, most_helpers_))
        can_hire_ = has_memory_for_a_thread() && hire_one();
}

// Start a helper thread; false where the system has no more threads or memory.
bool Team::hire_one() {
    std::unique_lock<std::mutex> lock(guard_);
    try {
        threads_.emplace_back(&Team::help, this);
    } catch (const std::exception&) {
        return false;
    }
    ++hired_;
    changed_.wait(lock, [&] { return begun_ == hired_; });
    return true;
}

// Call the kernel on ranges, on the calling thread, until all are done.
void Team::lead() {
    const Watch watch(call_, true);
    const Membership membership(*this);
    Range range;
    do {
        while (take(range)) {
            work_(range);
            finish();
        }
    } while (await_ranges());
}

// Call the kernel on ranges, on another thread, until all are done; without memory it
// gives its range back.
void Team::help() {
    const Watch watch(call_, false);
    const Membership membership(*this);
    begin();
    Range range;
    try {
        do {
            while (take(range)) {
                work_(range);
                finish();
            }
        } while (await_ranges());
    } catch (const std::bad_alloc&) {
        give_back(range);
    } catch (...) {
        fail();
    }
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
    } else if (next_ < count_) {
        range = {next_, std::min(next_ + step_, count_)};
        next_ = range.last;
    } else {
        return false;
    }
    ++running_;
    return true;
}

// Note that a range is done.
void Team::finish() {
    const std::lock_guard<std::mutex> lock(guard_);
    if (--running_ == 0) changed_.notify_all();
}

// Take parts of the loops of others until a range is given back, or all are done;
// returns whether one was given back.
bool Team::await_ranges() {
    std::unique_lock<std::mutex> lock(guard_);
    while (running_ > 0 && returned_.empty() && !failure_) {
        if (!has_parts()) changed_.wait_for(lock, BETWEEN_LOOKS);
        lock.unlock();
        take_parts();
        check_interrupt();
        lock.lock();
    }
    return !returned_.empty() && !failure_;
}

void Team::share(const SharedLoop& loop) {
    if (most_helpers_ == 0 || !post(loop)) return run_alone(loop);
    hire(loop.count - 1);
    take_parts();
    await_parts();
    call_.check_ended();
}

// Offer the parts of a loop to all threads; false where they have another loop.
bool Team::post(const SharedLoop& loop) {
    const std::lock_guard<std::mutex> lock(guard_);
    if (loop_) return false;
    loop_ = &loop;
    next_part_ = 0;
    changed_.notify_all();
    return true;
}

// Whether there are parts to take; with the guard.
bool Team::has_parts() const { return loop_ && next_part_ < loop_->count && !failure_; }

// Run parts of the shared loop until none is left. An exception ends the call.
void Team::take_parts() {
    std::unique_lock<std::mutex> lock(guard_);
    while (has_parts()) {
        const SharedLoop& loop = *loop_;
        const Index part = next_part_++;
        ++running_parts_;
        lock.unlock();
        try {
            loop.body(loop.data, part);
        } catch (...) {
            fail();
        }
        lock.lock();
        if (--running_parts_ == 0) changed_.notify_all();
    }
}

// Wait until no thread runs a part of the shared loop, and withdraw it. Signals are
// looked at, but an exception waits too: the loop is on the stack of this thread.
void Team::await_parts() {
    std::unique_lock<std::mutex> lock(guard_);
    while (running_parts_ > 0) {
        changed_.wait_for(lock, BETWEEN_LOOKS);
        lock.unlock();
        try {
            check_interrupt();
        } catch (...) {
            fail();
        }
        lock.lock();
    }
    loop_ = nullptr;
}

// Leave a range that was taken to another thread.
void Team::give_back(Range range) {
    const std::lock_guard<std::mutex> lock(guard_);
    --running_;
    returned_.push_back(range);
    changed_.notify_all();
}

// End the call with the exception that is being handled.
void Team::fail() {
    const std::lock_guard<std::mutex> lock(guard_);
    if (!failure_) failure_ = std::current_exception();
    call_.end();
    changed_.notify_all();
}

// Wait until all helpers have ended, also those that one hires meanwhile.
void Team::join() {
    std::unique_lock<std::mutex> lock(guard_);
    while (!threads_.empty()) {
        std::thread helper = std::move(threads_.back());
        threads_.pop_back();
        lock.unlock();
        helper.join();
        lock.lock();
    }
}

}  // namespace shapefit
