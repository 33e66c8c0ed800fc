// The module that says what an x86-64 processor can run: LEVEL is 2, 3 or 4, and 0 on
// another one. It is the only one that is loaded before a level is chosen, and needs
// Python's stable ABI alone.
#ifndef SHAPEFIT_PROBE
#include <Python.h>
#endif

#if defined(__x86_64__) || defined(_M_X64)
#ifdef _WIN32
#include <windows.h>
#endif

namespace shapefit {

// Whether processor and system run the instructions of a level of x86-64: v3 has AVX2,
// v4 AVX-512.
#ifdef _WIN32
inline bool runs_x86_64_v3() {
    return IsProcessorFeaturePresent(PF_AVX2_INSTRUCTIONS_AVAILABLE);
}
inline bool runs_x86_64_v4() {
    return IsProcessorFeaturePresent(PF_AVX512F_INSTRUCTIONS_AVAILABLE);
}
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

static const int LEVEL = shapefit::runs_x86_64_v4()   ? 4
                         : shapefit::runs_x86_64_v3() ? 3
                                                      : 2;
#else
static const int LEVEL = 0;
#endif

#ifdef SHAPEFIT_PROBE  // asked by the build: ends with the level

int main() { return LEVEL; }

#else

static PyModuleDef definition = {PyModuleDef_HEAD_INIT,
                                 "_processor",
                                 nullptr,
                                 -1,
                                 nullptr,
                                 nullptr,
                                 nullptr,
                                 nullptr,
                                 nullptr};

PyMODINIT_FUNC PyInit__processor() {
    PyObject* module = PyModule_Create(&definition);
    if (module) PyModule_AddIntConstant(module, "LEVEL", LEVEL);
    return module;
}

#endif
