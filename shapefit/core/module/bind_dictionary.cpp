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

    module.def(
        "find_objectives",
        [](In<2> shapes, In<2> atoms, In<2> coefficients, double beta, Out<1> objectives, int threads) {
            const MisfitData data{view(shapes), view(atoms), view(coefficients), beta,
                                  view(objectives)};
            const nb::gil_scoped_release released;
            run_stretches(data.shapes.size[0], threads,
                          [&](Range range) { level().kernels.find_objectives(data, range); });
        },
        nb::kw_only(), "shapes"_a, "atoms"_a, "coefficients"_a, "beta"_a, "objectives"_a,
        "threads"_a);

    module.def(
        "add_products",
        [](In<2> shapes, In<2> coefficients, Out<2> overlaps, Out<2> pulls) {
            const ProductsData data{view(shapes), view(coefficients), view(overlaps), view(pulls)};
            const nb::gil_scoped_release released;
            level().kernels.add_products(data);
        },
        nb::kw_only(), "shapes"_a, "coefficients"_a, "overlaps"_a, "pulls"_a);

    module.def(
        "update_atoms",
        [](In<2> overlaps, In<2> pulls, Out<2> atoms, double bound, long sweeps) {
            const AtomUpdateData data{view(overlaps), view(pulls), view(atoms), bound, sweeps};
            const nb::gil_scoped_release released;
            level().kernels.update_atoms(data);
        },
        nb::kw_only(), "overlaps"_a, "pulls"_a, "atoms"_a, "bound"_a, "sweeps"_a);
}

}  // namespace shapefit
