// The functions of one instruction set as a Python module, named after it.
#include <algorithm>
#include <cstring>
#include <deque>
#include <new>

#include "../base/memory.hpp"
#include "call.hpp"

namespace shapefit {

void raise_out_of_memory(Index) { throw std::bad_alloc(); }

namespace {

// Call a function of the registry with Python's arguments; returns its count, or None.
nb::object call_function(const Function& function, nb::args values,
                         nb::kwargs keywords) {
    Call call(function.name, std::move(values), std::move(keywords));
    function.call(call);
    return call.result();
}

// Add a function of the registry to the Python module, with its signature.
void bind_function(nb::module_& module, const Function& function) {
    static std::deque<std::string> signatures;  // Python keeps the pointers
    Signature list;
    function.call(list);
    const char* result = function.silent ? ") -> None" : ") -> int";
    signatures.push_back(std::string("def ") + function.name + "(" + list.text +
                         result);
    module.def(
        function.name,
        [&function](nb::args values, nb::kwargs keywords) {
            try {
                return call_function(function, std::move(values), std::move(keywords));
            } catch (const Interrupted&) {
                PyErr_SetNone(PyExc_KeyboardInterrupt);
                throw nb::python_error();
            }
        },
        nb::sig(signatures.back().c_str()));
}

}  // namespace
}  // namespace shapefit

NB_MODULE(SHAPEFIT_MODULE, module) {
    using namespace shapefit;
    module.attr("IMAGES_PER_BLOCK") = IMAGES_PER_BLOCK;
    std::vector<const Function*> functions;
    for (const Function* each = Function::first; each; each = each->next)
        functions.push_back(each);
    std::sort(functions.begin(), functions.end(),
              [](const Function* a, const Function* b) {
                  return std::strcmp(a->name, b->name) < 0;
              });
    for (const Function* each : functions) bind_function(module, *each);
}
