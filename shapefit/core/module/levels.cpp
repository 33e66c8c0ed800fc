// Which instruction sets this build has, which of them the processor can run, and the choice.
#include <chrono>
#include <cstdlib>
#include <cstring>
#include <new>
#include <stdexcept>
#include <string>

#include "../errors.hpp"
#include "../kernels.hpp"
#include "processor.hpp"

namespace shapefit {

#ifdef SHAPEFIT_HAS_x86_64_v4
namespace x86_64_v4 {
extern const Level table;
}
#endif
#ifdef SHAPEFIT_HAS_x86_64_v3
namespace x86_64_v3 {
extern const Level table;
}
#endif
#ifdef SHAPEFIT_HAS_x86_64_v2
namespace x86_64_v2 {
extern const Level table;
}
#endif
#ifdef SHAPEFIT_HAS_plain
namespace plain {
extern const Level table;
}
#endif

int available_levels(const Level** levels, int room) {
    int count = 0;
    const auto offer = [&](bool runs, const Level& found) {
        if (runs && count < room) levels[count++] = &found;
    };
#ifdef SHAPEFIT_HAS_x86_64_v4
    offer(runs_x86_64_v4(), x86_64_v4::table);
#endif
#ifdef SHAPEFIT_HAS_x86_64_v3
    offer(runs_x86_64_v3(), x86_64_v3::table);
#endif
#ifdef SHAPEFIT_HAS_x86_64_v2
    offer(true, x86_64_v2::table);
#endif
#ifdef SHAPEFIT_HAS_plain
    offer(true, plain::table);
#endif
    return count;
}

namespace {

const Level& choose_level() {
    const Level* levels[4];
    const int count = available_levels(levels, 4);
    const char* wanted = std::getenv("SHAPEFIT_LEVEL");
    if (!wanted || !*wanted) return *levels[0];
    std::string names;
    for (int i = 0; i < count; ++i) {
        if (!std::strcmp(levels[i]->name, wanted)) return *levels[i];
        names += std::string(i ? ", " : "") + levels[i]->name;
    }
    throw std::invalid_argument("SHAPEFIT_LEVEL is " + std::string(wanted) +
                                "; this build and processor have " + names);
}

}  // namespace

const Level& level() {
    static const Level& chosen = choose_level();
    return chosen;
}

void raise_out_of_memory(long) { throw std::bad_alloc(); }

double steady_seconds() {
    const auto now = std::chrono::steady_clock::now().time_since_epoch();
    return std::chrono::duration<double>(now).count();
}

}  // namespace shapefit
