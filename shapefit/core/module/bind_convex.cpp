// The kernels of the convex program as Python functions.
#include "../kernels.hpp"
#include "arrays.hpp"
#include "module.hpp"
#include "threads.hpp"

namespace shapefit {

using nb::literals::operator""_a;

void bind_convex(nb::module_& module, nb::module_&) {
    module.def(
        "solve_convex",
        [](In<3> landmarks, In<2> weights, In<3> atoms, In<1> lam, double delta, double bound,
           double tolerance, long most_steps, bool started, int threads, Out<4> transforms,
           Out<2> translation, Out<3> dual, Out<3> errors, Out<1> objective, Out<1> relative_gap,
           Out<1> residual, OutIndices<1> steps, OutIndices<1> status) {
            const ConvexTask task{
                {view(landmarks), view(weights), view(atoms), view(lam), delta, bound},
                {tolerance, most_steps, started},
                {view(transforms), view(translation), view(dual), view(errors)},
                {view(objective), view(relative_gap), view(residual)},
                {view(steps), view(status)}};
            const nb::gil_scoped_release released;
            run_stretches(task.program.landmarks.size[0], threads,
                          [&](Range range) { level().kernels.solve_convex(task, range); });
        },
        nb::kw_only(), "landmarks"_a, "weights"_a, "atoms"_a, "lam"_a, "delta"_a, "bound"_a,
        "tolerance"_a, "most_steps"_a, "started"_a, "threads"_a, "transforms"_a, "translation"_a,
        "dual"_a, "errors"_a, "objective"_a, "relative_gap"_a, "residual"_a, "steps"_a, "status"_a);

    module.def(
        "certify",
        [](In<3> landmarks, In<2> weights, In<3> atoms, In<1> lam, double delta, double bound,
           int threads, Out<4> transforms, Out<2> translation, Out<3> dual, Out<3> errors,
           Out<1> objective, Out<1> relative_gap, Out<1> residual) {
            const ConvexProgram program{view(landmarks), view(weights), view(atoms), view(lam),
                                        delta, bound};
            const ConvexPoint point{view(transforms), view(translation), view(dual), view(errors)};
            const ConvexProof proof{view(objective), view(relative_gap), view(residual)};
            const nb::gil_scoped_release released;
            run_stretches(program.landmarks.size[0], threads, [&](Range range) {
                level().kernels.certify(program, point, proof, range);
            });
        },
        nb::kw_only(), "landmarks"_a, "weights"_a, "atoms"_a, "lam"_a, "delta"_a, "bound"_a,
        "threads"_a, "transforms"_a, "translation"_a, "dual"_a, "errors"_a, "objective"_a,
        "relative_gap"_a, "residual"_a);
}

}  // namespace shapefit
