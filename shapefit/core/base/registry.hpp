// Functions that Python sees, each listed beside its code:
//
//   const Exported<solve_convex> exported{"solve_convex"};
//
// A kernel takes its data and a range of images, and is called on several threads; another function
// takes its data and is called once; a part, for the tests, takes numbers and arrays of any shape one
// after another.
#pragma once

#include "arguments.hpp"

namespace shapefit {

enum Where { MODULE, PART };

struct Function {
    Function(const char* name, Where place, bool silent, void (*call)(Arguments&))
        : name(name), place(place), silent(silent), call(call), next(first) {
        first = this;
    }

    const char* name;
    Where place;
    bool silent;  // returns nothing
    void (*call)(Arguments&);
    const Function* next;

    inline static const Function* first = nullptr;
};

// Numbers that a function returns: one, or those of a struct.
template <class Number>
void give(Arguments& to, Number number) {
    if constexpr (std::is_class_v<Number>)
        number.give_to(to);
    else if constexpr (Number(0.5) == Number(0) && Number(2) != Number(1))
        to.give_count(static_cast<long>(number));
    else if constexpr (sizeof(Number) == sizeof(bool))
        to.give_flag(number);
    else
        to.give_number(number);
}

template <auto function>
struct Caller;

template <class Data, void (*kernel)(const Data&, Range)>
struct Caller<kernel> {
    static constexpr bool silent = true;
    static void call(Arguments& from) {
        const Data data{from};
        from.run([](const void* all, Range range) { kernel(*static_cast<const Data*>(all), range); },
                 &data);
    }
};

template <class Data, class Result, Result (*function)(const Data&)>
struct Caller<function> {
    static constexpr bool silent = std::is_void_v<Result>;
    static void call(Arguments& from) {
        const Data data{from};
        if (!from.begin()) return;
        if constexpr (std::is_void_v<Result>)
            function(data);
        else
            give(from, function(data));
    }
};

template <class Result, class... Values, Result (*part)(Values...)>
    requires(!(std::is_reference_v<Values> || ...))
struct Caller<part> {
    static constexpr bool silent = false;
    // The order of arguments in braces is fixed, unlike that of a call's.
    struct InOrder {
        InOrder(Arguments& from, Values... values) {
            if (!from.begin()) return;
            if constexpr (std::is_void_v<Result>)
                part(values...);
            else
                give(from, part(values...));
        }
    };
    static void call(Arguments& from) {
        InOrder{from, static_cast<Values>(from(""))...};
    }
};

template <auto function>
struct Exported : Function {
    explicit Exported(const char* name, Where place = MODULE)
        : Function(name, place, Caller<function>::silent, Caller<function>::call) {}
};

}  // namespace shapefit
