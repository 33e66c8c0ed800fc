// How the call of a kernel ends before its time.
//
// All its threads call `check_interrupt` once a step. On the thread that Python called
// the handlers of signals run, 20 times a second: what they raise ends the call. They
// do nothing on other threads than the first of Python; one of a pool names a flag
// (`set_stop_flag`), and its calls end once that is set.
#pragma once

#include <atomic>
#include <chrono>

#include "../base/memory.hpp"

namespace shapefit {

using Clock = std::chrono::steady_clock;

constexpr std::chrono::milliseconds BETWEEN_LOOKS{50};  // at signals

// Thrown on the threads of a call that a flag or another of its threads has ended.
struct Interrupted {};

// A call of a kernel, made on the thread that Python called.
class KernelCall {
  public:
    KernelCall();

    // Let all threads of the call end when they next check.
    void end() { ended_.store(true, std::memory_order_relaxed); }

    // Throw Interrupted where the call is to end.
    void check_ended() const;

    // Throw Interrupted where the call is to end, or what a handler of signals raises;
    // handlers run at most once in BETWEEN_LOOKS. On the thread that Python called.
    void check_signals();

  private:
    const bool* stop_;  // null where this thread obeys no flag
    std::atomic<bool> ended_{false};
    Clock::time_point looked_ = Clock::now();
};

// While it lives, `check_interrupt` on this thread checks whether this call is to end.
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
