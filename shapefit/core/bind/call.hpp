// The arguments of a call from Python, and what they are called.
#pragma once

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "../base/registry.hpp"
#include "interrupt.hpp"

namespace shapefit {

namespace nb = nanobind;

// A call from Python, with its arguments. Arrays are C-contiguous and have their
// element type; those that are only read may be copies. Raises TypeError for an
// argument that is missing, unknown or of another type, ValueError for an array of
// another shape.
class Call : public Arguments {
  public:
    Call(const char* function, nb::args values, nb::kwargs keywords);

    void take_array(const Argument& argument, AnyArray& array) override;
    double take_number(const Argument& argument) override;
    Index take_count(const Argument& argument) override;
    bool take_flag(const Argument& argument) override;

    bool begin() override;
    void run(void (*kernel)(const void* data, Range), const void* data) override;
    void give_count(Index value) override { count_ = value; }

    // The count that the function returned, as an int of Python, or None.
    nb::object result();

  private:
    // A function that is called once: others may use Python meanwhile.
    struct Running {
        KernelCall call;
        Watch watch{call, true};
        nb::gil_scoped_release released;
    };
    struct Size {
        std::string_view name;
        Index value;
    };

    // Each is explained in call.cpp.
    void end() const;
    Index size(std::string_view name) const;
    nb::handle find(const Argument& argument);
    bool fits(std::string_view token, Index value);
    bool has_shape(const Argument& argument, const AnyArray& array);
    [[noreturn]] void refuse(const Argument& argument, const std::string& wanted,
                             nb::handle given, bool is_array = false);

    const char* function_;
    nb::args values_;
    nb::kwargs keywords_;
    size_t taken_ = 0;
    std::vector<Size> sizes_;
    std::vector<nb::ndarray<>> retained_;
    std::optional<Index> count_;
    std::optional<Running> running_;  // while the function runs
};

// The list of arguments as the signature of a Python function: nothing is taken and no
// function runs.
class Signature : public Arguments {
  public:
    void take_array(const Argument& argument, AnyArray& array) override;
    double take_number(const Argument& argument) override {
        return add(argument, "float"), 0;
    }
    Index take_count(const Argument& argument) override {
        return add(argument, "int"), 0;
    }
    bool take_flag(const Argument& argument) override {
        return add(argument, "bool"), false;
    }

    bool begin() override { return false; }
    void run(void (*)(const void* data, Range), const void*) override {
        add({*this, "threads", ""}, "int");
    }
    void give_count(Index) override {}

    std::string text;

  private:
    void add(const Argument& argument, const char* type);
};

}  // namespace shapefit
