// Views of row-major arrays that Python owns: a pointer and the sizes, nothing else.
//
// Every member function is inlined wherever it is used, so that no code compiled for one
// instruction set can be kept by the linker for another.
#pragma once

#include <type_traits>

namespace shapefit {

template <class T, int rank>
struct View {
    T* data = nullptr;
    long size[rank] = {};

    View<T, rank - 1> operator[](long i) const {
        View<T, rank - 1> part;
        long stride = 1;
        for (int d = 1; d < rank; ++d) {
            part.size[d - 1] = size[d];
            stride *= size[d];
        }
        part.data = data + i * stride;
        return part;
    }
    operator View<const T, rank>() const
        requires(!std::is_const_v<T>)
    {
        View<const T, rank> same;
        same.data = data;
        for (int d = 0; d < rank; ++d) same.size[d] = size[d];
        return same;
    }
};

template <class T>
struct View<T, 1> {
    T* data = nullptr;
    long size[1] = {};

    T& operator[](long i) const { return data[i]; }
    operator View<const T, 1>() const
        requires(!std::is_const_v<T>)
    {
        return {data, {size[0]}};
    }
};

template <class T>
using Vector = View<T, 1>;
template <class T>
using Matrix = View<T, 2>;
template <class T>
using Tensor = View<T, 3>;
template <class T>
using Blocks = View<T, 4>;

// Images first <= image < last of a batch: whole stretches, but for the end of the batch.
struct Range {
    long first = 0;
    long last = 0;
};

// Images of one stretch may start from one another's solutions; each stretch starts afresh. Its
// length is fixed, so that no result depends on the number of threads, nor on how a file is cut into
// batches of whole stretches.
constexpr long STRETCH = 64;

}  // namespace shapefit
