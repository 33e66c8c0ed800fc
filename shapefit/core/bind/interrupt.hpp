// How the call of a kernel ends before its time.
//
// All its threads ask `check_interrupt` once a step. On the thread that Python called
// the handlers of signals run, 20 times a second: what they raise ends the call. They
// do nothing on other threads than the first of Python; one of a pool names a flag
// (`obey`), and its calls end once that is set.
#pragma once

#include <atomic>
#include <chrono>

#include "../base/memory.hpp"

namespace shapefit {

using Clock = std::chrono::steady_clock;

constexpr std::chrono::milliseconds BETWEEN_LOOKS{50};  // at signals

// Ends the threads of a call that another thread has ended.
struct Interrupted {};

// A call of a kernel, made on the thread that Python called.
class KernelCall {
  public:
    KernelCall();

    void end() { ended_.store(true, std::memory_order_relaxed); }

    // Throws Interrupted where the call is to end.
    void check_ended() const;

    // Throws what a handler of signals raises. On the thread that Python called.
    void check_signals();

  private:
    const bool* stop_;  // null where this thread obeys no flag
    std::atomic<bool> ended_{false};
    Clock::time_point looked_ = Clock::now();
};

// While it lives, `check_interrupt` on this thread asks the call.
class Watch {
  public:
    Watch(KernelCall& call, bool called_by_python);
    ~Watch();
    Watch(const Watch&) = delete;
    Watch& operator=(const Watch&) = delete;

  private:
    const Watch* const before_;
    KernelCall& call_;
    const bool called_by_python_;

    friend void check_interrupt();
};

}  // namespace shapefit
