// The kernels of the refinement under perspective as Python functions.
#include "../kernels.hpp"
#include "arrays.hpp"
#include "module.hpp"
#include "threads.hpp"

namespace shapefit {

using nb::literals::operator""_a;

void bind_perspective(nb::module_& module, nb::module_& parts) {
    module.def(
        "refine_perspective",
        [](In<3> landmarks, In<2> weights, In<3> atoms, In<1> prior, In<2> focal, In<2> centre,
           double sign, double ridge, double softness, long max_rounds, Out<3> rotation,
           Out<2> translation, Out<2> coefficients, Out<1> objective, OutIndices<1> rounds,
           OutIndices<1> status, int threads) {
            const PerspectiveData data{
                view(landmarks),   view(weights),      view(atoms),     view(prior),
                view(focal),       view(centre),       sign,            ridge,
                softness,          max_rounds,         view(rotation),  view(translation),
                view(coefficients), view(objective),   view(rounds),    view(status)};
            const nb::gil_scoped_release released;
            run_stretches(data.landmarks.size[0], threads,
                          [&](Range range) { level().kernels.refine_perspective(data, range); });
        },
        nb::kw_only(), "landmarks"_a, "weights"_a, "atoms"_a, "prior"_a, "focal"_a, "centre"_a,
        "sign"_a, "ridge"_a, "softness"_a, "max_rounds"_a, "rotation"_a, "translation"_a,
        "coefficients"_a, "objective"_a, "rounds"_a, "status"_a, "threads"_a);

    // One image: X (3, p) and r (2, p).
    parts.def("project_perspective",
              [](In<3> landmarks, In<2> weights, In<3> atoms, In<2> focal, In<2> centre,
                 double sign, Out<3> rotation, Out<2> translation, Out<2> coefficients, Out<2> X,
                 Out<2> r) {
                  PerspectiveData data{};
                  data.landmarks = view(landmarks);
                  data.weights = view(weights);
                  data.atoms = view(atoms);
                  data.prior = {coefficients.data(), {static_cast<long>(coefficients.shape(1))}};
                  data.focal = view(focal);
                  data.centre = view(centre);
                  data.sign = sign;
                  data.rotation = view(rotation);
                  data.translation = view(translation);
                  data.coefficients = view(coefficients);
                  level().parts.project_perspective(data, view(X), view(r));
              });
}

}  // namespace shapefit
