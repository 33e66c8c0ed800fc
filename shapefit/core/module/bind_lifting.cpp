// The kernels of lifting as Python functions.
#include "../kernels.hpp"
#include "arrays.hpp"
#include "module.hpp"
#include "threads.hpp"

namespace shapefit {

using nb::literals::operator""_a;

void bind_lifting(nb::module_& module, nb::module_& parts) {
    module.def(
        "synchronise",
        [](In<4> transforms, Out<3> rotation, int threads) {
            const SynchronisationData data{view(transforms), view(rotation)};
            const nb::gil_scoped_release released;
            run_stretches(data.transforms.size[0], threads,
                          [&](Range range) { level().kernels.synchronise(data, range); });
        },
        nb::kw_only(), "transforms"_a, "rotation"_a, "threads"_a);

    parts.def("climb", [](In<3> blocks, Out<2> R) -> double { return level().parts.climb(view(blocks), view(R)); });
    parts.def("polar_rotation",
              [](In<2> A, Out<2> R) -> bool { return level().parts.polar_rotation(view(A), view(R)); });
    parts.def("scaled_coefficients", [](In<2> Q, In<1> h, In<1> a, Out<1> x) {
        level().parts.scaled_coefficients(view(Q), view(h), view(a), view(x));
    });
}

}  // namespace shapefit
