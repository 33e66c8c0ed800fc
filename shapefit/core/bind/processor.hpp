// What an x86-64 processor can run, feature by feature: older compilers do not know the levels.
#pragma once

#if defined(__x86_64__) || defined(_M_X64)

#ifdef _WIN32
#include <windows.h>
#endif

namespace shapefit {

#ifdef _WIN32
inline bool runs_x86_64_v3() { return IsProcessorFeaturePresent(PF_AVX2_INSTRUCTIONS_AVAILABLE); }
inline bool runs_x86_64_v4() { return IsProcessorFeaturePresent(PF_AVX512F_INSTRUCTIONS_AVAILABLE); }
#else
inline bool runs_x86_64_v3() {
    __builtin_cpu_init();
    return __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma") &&
           __builtin_cpu_supports("bmi") && __builtin_cpu_supports("bmi2");
}

inline bool runs_x86_64_v4() {
    return runs_x86_64_v3() && __builtin_cpu_supports("avx512f") &&
           __builtin_cpu_supports("avx512bw") && __builtin_cpu_supports("avx512cd") &&
           __builtin_cpu_supports("avx512dq") && __builtin_cpu_supports("avx512vl");
}
#endif

}  // namespace shapefit

#endif
