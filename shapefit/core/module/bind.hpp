// Kernels and parts as Python functions, by the types of their arguments alone.
#pragma once

#include <deque>
#include <tuple>

#include "../kernels.hpp"
#include "call.hpp"
#include "threads.hpp"

namespace shapefit {

// Numbers that a kernel returns, as Python has them.
inline nb::object to_python(Misfit misfit) { return nb::make_tuple(misfit.value, misfit.scale); }
inline nb::object to_python(TrustedStep step) { return nb::make_tuple(step.at_edge, step.fall); }
inline nb::object to_python(AlternationEnd end) { return nb::make_tuple(end.steps, end.converged); }
inline nb::object to_python(TreeSize size) {
    return nb::make_tuple(size.cells, size.vertices, size.complete);
}
template <class Number>
nb::object to_python(Number number) {
    return nb::cast(number);
}

// Python keeps the pointer to a signature.
inline const char* kept(std::string text) {
    static std::deque<std::string> all;
    return all.emplace_back(std::move(text)).c_str();
}

template <class Data>
const char* signature(const char* name, const char* rest, const char* result) {
    Signature list;
    Data{list};
    return kept(std::string("def ") + name + "(" + list.text + rest + ") -> " + result);
}

// A kernel over the images of a batch, n of them in the shapes, on several threads.
template <class Data>
void define(nb::module_& module, const char* name, void (*kernel)(const Data&, Range)) {
    module.def(
        name,
        [=](nb::args values, nb::kwargs keywords) {
            Call call(name, std::move(values), std::move(keywords));
            const Data data{call};
            const int threads = static_cast<int>(long(call("threads")));
            call.end();
            const nb::gil_scoped_release released;
            run_stretches(call.size("n"), threads, [&](Range range) { kernel(data, range); });
        },
        nb::sig(signature<Data>(name, ", threads: int", "None")));
}

// A kernel that is called once.
template <class Data, class Result>
void define(nb::module_& module, const char* name, Result (*kernel)(const Data&)) {
    constexpr bool silent = std::is_void_v<Result>;
    const auto run = [=](nb::args values, nb::kwargs keywords) -> nb::object {
        Call call(name, std::move(values), std::move(keywords));
        const Data data{call};
        call.end();
        if constexpr (silent) {
            const nb::gil_scoped_release released;
            kernel(data);
        } else {
            const Result result = [&] {
                const nb::gil_scoped_release released;
                return kernel(data);
            }();
            return to_python(result);
        }
        return nb::none();
    };
    module.def(name, run, nb::sig(signature<Data>(name, "", silent ? "None" : "Any")));
}

// A part that takes numbers and arrays of any shape one after another.
template <class Result, class... Values>
void define(nb::module_& parts, const char* name, Result (*part)(Values...)) {
    parts.def(
        name,
        [=](nb::args values, nb::kwargs keywords) -> nb::object {
            Call call(name, std::move(values), std::move(keywords));
            const std::tuple<Values...> all{static_cast<Values>(call(""))...};
            call.end();
            if constexpr (std::is_void_v<Result>) {
                std::apply(part, all);
                return nb::none();
            } else {
                return to_python(std::apply(part, all));
            }
        },
        nb::sig(kept(std::string("def ") + name + "(*values: Any) -> Any")));
}

}  // namespace shapefit
