#include "call.hpp"

#include <algorithm>

#include "threads.hpp"

namespace shapefit {
namespace {

struct Type {
    const char *in_python, *in_numpy;
};
constexpr Type TYPES[] = {{"Floats", "float64"},
                          {"Flags", "bool"},
                          {"Indices", "int64"},
                          {"States", "uint64"}};

// The names of an element type in signatures of Python and in NumPy.
const Type& type_of(Element element) { return TYPES[static_cast<int>(element)]; }

constexpr int NO_ARRAY = -1;

// Point `array` at the elements of a Python object, or of a copy where they are only
// read, if it is an array of element type T and of the rank of `array`; returns its
// rank, or NO_ARRAY where it is no array of that type.
template <class T>
int read(nb::handle given, AnyArray& array, std::vector<nb::ndarray<>>& retained) {
    const auto look = [&](auto found) {
        const int rank = static_cast<int>(found.ndim());
        if (rank != array.rank) return rank;
        array.data = const_cast<std::remove_const_t<T>*>(found.data());
        for (int d = 0; d < array.rank; ++d)
            array.size[d] = static_cast<Index>(found.shape(d));
        retained.emplace_back(found);
        return rank;
    };
    if (array.written) {
        nb::ndarray<T, nb::c_contig, nb::device::cpu> found;
        return nb::try_cast(given, found, false) ? look(found) : NO_ARRAY;
    }
    nb::ndarray<const T, nb::c_contig, nb::device::cpu> found;
    return nb::try_cast(given, found) ? look(found) : NO_ARRAY;
}

// str(value).
std::string text_of(const nb::object& value) {
    return nb::str(nb::handle(value)).c_str();
}

// Call visit(part) for the parts of a text between spaces.
template <class Visit>
void each_token(std::string_view text, const Visit& visit) {
    while (!text.empty()) {
        const size_t end = std::min(text.find(' '), text.size());
        visit(text.substr(0, end));
        text.remove_prefix(std::min(end + 1, text.size()));
    }
}

}  // namespace

Call::Call(const char* function, nb::args values, nb::kwargs keywords)
    : function_(function), values_(std::move(values)), keywords_(std::move(keywords)) {}

// The value of the keyword that an argument names. Raises TypeError where there is
// none.
nb::handle Call::find(const Argument& argument) {
    if (!keywords_.contains(argument.name))
        throw nb::type_error(
            (std::string(function_) + ": no " + argument.name).c_str());
    ++taken_;
    return nb::handle(PyDict_GetItemString(keywords_.ptr(), argument.name));
}

// Point `array` at the array of a keyword. Raises TypeError for another type,
// ValueError for another shape.
void Call::take_array(const Argument& argument, AnyArray& array) {
    const nb::handle given = find(argument);
    int rank = NO_ARRAY;
    switch (array.element) {
        case Element::NUMBER:
            rank = read<double>(given, array, retained_);
            break;
        case Element::FLAG:
            rank = read<bool>(given, array, retained_);
            break;
        case Element::INDEX:
            rank = read<int64_t>(given, array, retained_);
            break;
        case Element::STATE:
            rank = read<uint64_t>(given, array, retained_);
            break;
    }
    const bool is_array = rank != NO_ARRAY;
    if (!is_array || rank != array.rank || !has_shape(argument, array)) {
        const std::string kind =
            array.written ? "a writable, C-contiguous array of " : "an array of ";
        refuse(argument,
               kind + type_of(array.element).in_numpy + " (" + argument.shape + ")",
               given, is_array);
    }
}

// The float of a keyword. Raises TypeError for what is no number.
double Call::take_number(const Argument& argument) {
    const nb::handle given = find(argument);
    double value = 0;
    if (!nb::try_cast(given, value)) refuse(argument, "a number", given);
    return value;
}

// The int of a keyword. Raises TypeError for what is no whole number.
Index Call::take_count(const Argument& argument) {
    const nb::handle given = find(argument);
    Index value = 0;
    if (!nb::try_cast(given, value)) refuse(argument, "an integer", given);
    return value;
}

// The bool of a keyword. Raises TypeError for what is neither True nor False.
bool Call::take_flag(const Argument& argument) {
    const nb::handle given = find(argument);
    bool value = false;
    if (!nb::try_cast(given, value)) refuse(argument, "True or False", given);
    return value;
}

// Release Python's lock for a function that is called once, after its last argument.
// Returns true, as the function is to be called; raises TypeError where arguments are
// left.
bool Call::begin() {
    end();
    running_.emplace();
    return true;
}

// Take the argument `threads`, and run a kernel on all n images without Python's lock.
void Call::run(void (*kernel)(const void* data, Range), const void* data) {
    const int threads = static_cast<int>(take_count({*this, "threads", ""}));
    end();
    const nb::gil_scoped_release released;
    run_blocks({kernel, data}, size("n"), threads);
}

// The count that the function returned, or None; acquires Python's lock again.
nb::object Call::result() {
    running_.reset();
    return count_ ? nb::int_(*count_) : nb::object(nb::none());
}

// Raise TypeError where arguments were given that were not taken.
void Call::end() const {
    const size_t given = values_.size() + keywords_.size();
    if (taken_ == given) return;
    const std::string text =
        std::to_string(given) + " arguments, " + std::to_string(taken_);
    throw nb::type_error((std::string(function_) + ": " + text + " are known").c_str());
}

// The size that a name in the shapes stands for, 0 where it does not occur.
Index Call::size(std::string_view name) const {
    for (const Size& size : sizes_)
        if (size.name == name) return size.value;
    return 0;
}

// Whether an array has the shape of its argument; sizes with a new name are stored.
bool Call::has_shape(const Argument& argument, const AnyArray& array) {
    std::string_view shape = argument.shape;
    if (shape.back() == '?') {
        for (int d = 0; d < array.rank; ++d)
            if (array.size[d] == 0) return true;
        shape.remove_suffix(1);
    }
    int d = 0;
    bool fit = true;
    each_token(shape, [&](std::string_view token) {
        fit = fit && d < array.rank && fits(token, array.size[d]);
        ++d;
    });
    return fit && d == array.rank;
}

// Whether the size of an axis fits its part of a shape, "3", "p", "3p" or "1+k": the
// first size that a name meets is stored as its own.
bool Call::fits(std::string_view token, Index value) {
    Index number = 0;
    bool leads = false;
    for (; !token.empty() && token[0] >= '0' && token[0] <= '9';
         token.remove_prefix(1)) {
        number = 10 * number + (token[0] - '0');
        leads = true;
    }
    if (token.empty()) return value == number;
    if (token[0] == '+') {
        token.remove_prefix(1);
        value -= number;
    } else if (leads) {
        if (value % number != 0) return false;
        value /= number;
    }
    for (const Size& size : sizes_)
        if (size.name == token) return size.value == value;
    sizes_.push_back({token, value});
    return true;
}

// Raise ValueError if `is_array`, else TypeError, that names the argument, what it must
// be and what was given.
void Call::refuse(const Argument& argument, const std::string& wanted, nb::handle given,
                  bool is_array) {
    std::string found = text_of(given.type().attr("__name__"));
    if (nb::hasattr(given, "dtype") && nb::hasattr(given, "shape"))
        found = text_of(given.attr("dtype")) + " " + text_of(given.attr("shape"));
    std::string text = std::string(function_) + ": " + argument.name;
    text += " must be " + wanted;
    for (const Size& size : sizes_)
        text += std::string(&size == sizes_.data() ? " with " : ", ") +
                std::string(size.name) + " = " + std::to_string(size.value);
    text += ", not " + found;
    if (is_array) throw nb::value_error(text.c_str());
    throw nb::type_error(text.c_str());
}

// Append an array argument to the signature, and read nothing.
void Signature::take_array(const Argument& argument, AnyArray& array) {
    add(argument, type_of(array.element).in_python);
}

// Append "name: type" to the signature.
void Signature::add(const Argument& argument, const char* type) {
    text += std::string(text.empty() ? "" : ", ") + argument.name + ": " + type;
}

}  // namespace shapefit
