// The kernels of dictionary as Python functions.
#include "../kernels.hpp"
#include "arrays.hpp"
#include "module.hpp"
#include "threads.hpp"

namespace shapefit {

using nb::literals::operator""_a;

void bind_dictionary(nb::module_& module) {
    module.def(
        "code",
        [](In<2> gram, In<2> pulls, In<1> smallest_moves, Out<2> coefficients, OutFlags<1> unsettled,
           int threads) {
            const CodingData data{view(gram), view(pulls), view(smallest_moves), view(coefficients),
                                  view(unsettled)};
            const nb::gil_scoped_release released;
            run_stretches(data.pulls.size[0], threads,
                          [&](Range range) { level().kernels.code(data, range); });
        },
        nb::kw_only(), "gram"_a, "pulls"_a, "smallest_moves"_a, "coefficients"_a, "unsettled"_a,
        "threads"_a);
}

}  // namespace shapefit
