#include "interrupt.hpp"

#include <nanobind/nanobind.h>

#include "../base/registry.hpp"

namespace shapefit {
namespace {

thread_local const bool* stop_flag = nullptr;
thread_local const Watch* watch = nullptr;

}  // namespace

KernelCall::KernelCall() : stop_(stop_flag) {}

void KernelCall::check_ended() const {
    if (ended_.load(std::memory_order_relaxed)) throw Interrupted();
    if (stop_ && __atomic_load_n(stop_, __ATOMIC_RELAXED)) throw Interrupted();
}

void KernelCall::check_signals() {
    check_ended();
    if (stop_) return;
    const Clock::time_point now = Clock::now();
    if (now - looked_ < BETWEEN_LOOKS) return;
    looked_ = now;
    const nanobind::gil_scoped_acquire acquired;
    if (PyErr_CheckSignals() != 0) throw nanobind::python_error();
}

Watch::Watch(KernelCall& call, bool called_by_python)
    : before_(watch), call_(call), called_by_python_(called_by_python) {
    watch = this;
}

Watch::~Watch() { watch = before_; }

void check_interrupt() {
    if (!watch) return;
    if (watch->called_by_python_) watch->call_.check_signals();
    else watch->call_.check_ended();
}

// A flag that ends the kernels that the calling thread calls from now on, once it is
// set. The flag outlives the thread.
struct StopFlagData {
    Arguments& from;
    Vector<const bool> stop = from("stop", "1");
};

// Let a flag end the kernels that the calling thread calls, see StopFlagData.
void set_stop_flag(const StopFlagData& data) { stop_flag = data.stop.data; }

const Exported<set_stop_flag> set_stop_flag_exported{"set_stop_flag"};

}  // namespace shapefit
