// The module that says what an x86-64 processor can run: LEVEL is 2, 3 or 4, and 0 on another one.
// It is the only one that is loaded before a level is chosen, and needs Python's stable ABI alone.
#ifndef SHAPEFIT_PROBE
#include <Python.h>
#endif

#if defined(__x86_64__) || defined(_M_X64)
#include "processor.hpp"
static const int LEVEL = shapefit::runs_x86_64_v4() ? 4 : shapefit::runs_x86_64_v3() ? 3 : 2;
#else
static const int LEVEL = 0;
#endif

#ifdef SHAPEFIT_PROBE  // asked by the build: ends with the level

int main() { return LEVEL; }

#else

static PyModuleDef definition = {PyModuleDef_HEAD_INIT, "_processor", nullptr, -1, nullptr,
                                 nullptr, nullptr, nullptr, nullptr};

PyMODINIT_FUNC PyInit__processor() {
    PyObject* module = PyModule_Create(&definition);
    if (module) PyModule_AddIntConstant(module, "LEVEL", LEVEL);
    return module;
}

#endif
