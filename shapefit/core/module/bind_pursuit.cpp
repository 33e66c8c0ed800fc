// The kernels of matching pursuit as Python functions.
#include "../kernels.hpp"
#include "arrays.hpp"
#include "module.hpp"
#include "threads.hpp"

namespace shapefit {

using nb::literals::operator""_a;

void bind_pursuit(nb::module_& module, nb::module_& parts) {
    module.def(
        "pursue",
        [](In<3> landmarks, In<2> weights, In<3> shapes, In<2> limbs, double length, double goal,
           double change, long most_atoms, long most_rounds, Out<2> coefficients, Out<3> cameras,
           Out<1> errors, OutIndices<1> rounds, OutIndices<1> status, int threads) {
            const PursuitData data{view(landmarks),
                                   view(weights),
                                   view(shapes),
                                   view(limbs),
                                   {length, goal, change, most_atoms, most_rounds},
                                   view(coefficients),
                                   view(cameras),
                                   view(errors),
                                   view(rounds),
                                   view(status)};
            const nb::gil_scoped_release released;
            run_stretches(data.landmarks.size[0], threads,
                          [&](Range range) { level().kernels.pursue(data, range); });
        },
        nb::kw_only(), "landmarks"_a, "weights"_a, "shapes"_a, "limbs"_a, "length"_a, "goal"_a,
        "change"_a, "most_atoms"_a, "most_rounds"_a, "coefficients"_a, "cameras"_a, "errors"_a,
        "rounds"_a, "status"_a, "threads"_a);

    parts.def("minimise_on_sphere", [](In<2> G, In<1> g, double radius, Out<1> y) -> double {
        return level().parts.minimise_on_sphere(view(G), view(g), radius, view(y));
    });
}

}  // namespace shapefit
