// Functions that Python sees, each listed beside its code:
//
//   const Exported<solve_convex> exported{"solve_convex"};
//
// A kernel takes its data and a range of images, and is called on several threads;
// another function takes its data and is called once, and may return a count.
//
// The arguments of a kernel, listed once: the members of its data, each with its name
// and shape.
//
// From the list follow the keywords of the Python function, its signature and the
// checks. Sizes of one name are one size: "n 2 p", "n 3p 3p", "1+k"; "n p?" may also be
// an array without elements.
#pragma once

#include <stdint.h>

#include "memory.hpp"

namespace shapefit {

enum class Element { NUMBER, FLAG, INDEX, STATE };  // double, bool, int64_t, uint64_t

template <class T>
constexpr Element element_of = std::is_same_v<T, double>    ? Element::NUMBER
                               : std::is_same_v<T, bool>    ? Element::FLAG
                               : std::is_same_v<T, int64_t> ? Element::INDEX
                                                            : Element::STATE;

// An array as Python has it: its rank is known, its elements may be written or not.
struct AnyArray {
    Element element;
    bool written;
    int rank;
    void* data = nullptr;
    Index size[4] = {};
};

// How the work on an image ended, in the order of `Status` in convex/solver.py.
struct Status {
    enum : int64_t {
        OPTIMAL,
        CONVERGED,
        ITERATION_LIMIT,
        DEGENERATE,
        NUMERICAL_FAILURE
    };
};

class Arguments;

// The name and shape of an argument as it is listed; the type is that of the member
// that it initialises.
struct Argument {
    Arguments& from;
    const char *name, *shape;

    // Its value in the call: see the functions `take_` of Arguments.
    template <class T, int rank>
    operator View<T, rank>() const;
    operator double() const;
    operator Index() const;
    operator bool() const;
};

// The arguments of one call and the count that it returns; or, where only the list of
// arguments is wanted, of no call.
class Arguments {
  public:
    // The argument of this name and shape, to initialise a member of the data with.
    Argument operator()(const char* name, const char* shape = "") {
        return {*this, name, shape};
    }

    // The value of the keyword that the argument names: an array, of the element type
    // and rank of `array`, which is pointed at it; a number; an integer; a flag. Each
    // keyword of a call is taken once, and one that nobody has taken is an error.
    virtual void take_array(const Argument& argument, AnyArray& array) = 0;
    virtual double take_number(const Argument& argument) = 0;
    virtual Index take_count(const Argument& argument) = 0;
    virtual bool take_flag(const Argument& argument) = 0;

    // Called after the last argument of a function that is called once; returns whether
    // the function is to be called.
    virtual bool begin() = 0;
    // Called after the last argument of a kernel: call it on ranges that cover all
    // images, on several threads.
    virtual void run(void (*kernel)(const void* data, Range), const void* data) = 0;
    // Set the count that the call returns to Python.
    virtual void give_count(Index value) = 0;

  protected:
    ~Arguments() = default;
};

inline Argument::operator double() const { return from.take_number(*this); }
inline Argument::operator Index() const { return from.take_count(*this); }
inline Argument::operator bool() const { return from.take_flag(*this); }

template <class T, int rank>
Argument::operator View<T, rank>() const {
    using Value = std::remove_const_t<T>;
    AnyArray array{element_of<Value>, !std::is_const_v<T>, rank};
    from.take_array(*this, array);
    View<T, rank> view{static_cast<T*>(array.data)};
    for (int d = 0; d < rank; ++d) view.size[d] = array.size[d];
    return view;
}

// A function that Python sees. Constructing one adds it to the list that begins with
// `first`.
struct Function {
    Function(const char* name, bool silent, void (*call)(Arguments&))
        : name(name), silent(silent), call(call), next(first) {
        first = this;
    }

    const char* name;
    bool silent;  // returns nothing
    void (*call)(Arguments&);
    const Function* next;

    inline static const Function* first = nullptr;
};

// How a function is called: its data are made of the arguments, and a kernel goes to
// `Arguments::run`. `silent`: it returns nothing.
template <auto function>
struct Caller;

template <class Data, void (*kernel)(const Data&, Range)>
struct Caller<kernel> {
    static constexpr bool silent = true;
    static void call(Arguments& from) {
        const Data data{from};
        from.run([](const void* all,
                    Range range) { kernel(*static_cast<const Data*>(all), range); },
                 &data);
    }
};

template <class Data, class Result, Result (*function)(const Data&)>
struct Caller<function> {
    static constexpr bool silent = std::is_void_v<Result>;
    static void call(Arguments& from) {
        const Data data{from};
        if (!from.begin()) return;
        if constexpr (std::is_void_v<Result>) function(data);
        else from.give_count(function(data));
    }
};

// Lists a function under the name that Python calls it by.
template <auto function>
struct Exported : Function {
    explicit Exported(const char* name)
        : Function(name, Caller<function>::silent, Caller<function>::call) {}
};

}  // namespace shapefit
