// NumPy arrays as views, without a copy. An array of another type, layout or rank is a TypeError.
#pragma once

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include "../algebra/views.hpp"

namespace shapefit {

namespace nb = nanobind;

template <class T, int rank>
using Array = nb::ndarray<T, nb::ndim<rank>, nb::c_contig, nb::device::cpu>;
template <int rank>
using In = Array<const double, rank>;
template <int rank>
using Out = Array<double, rank>;
template <int rank>
using OutIndices = Array<int64_t, rank>;
template <int rank>
using OutFlags = Array<bool, rank>;
template <int rank>
using InFlags = Array<const bool, rank>;
template <int rank>
using InIndices = Array<const int64_t, rank>;

template <class T, auto... sizes>
View<T, sizeof...(sizes)> view(
    const nb::ndarray<T, nb::shape<sizes...>, nb::c_contig, nb::device::cpu>& array) {
    View<T, sizeof...(sizes)> result;
    result.data = array.data();
    for (size_t d = 0; d < sizeof...(sizes); ++d) result.size[d] = static_cast<long>(array.shape(d));
    return result;
}

}  // namespace shapefit
