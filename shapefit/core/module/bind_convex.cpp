// The kernels of the convex program as Python functions.
#include "../kernels.hpp"
#include "arrays.hpp"
#include "module.hpp"
#include "threads.hpp"

namespace shapefit {

using nb::literals::operator""_a;

namespace {

void bind_convex_parts(nb::module_& parts) {
    parts.def("correlate", [](In<2> Y, In<3> atoms, Out<2> N) {
        level().parts.correlate(view(Y), view(atoms), view(N));
    });
    parts.def("largest_nuclear_norm",
              [](In<2> N) -> double { return level().parts.largest_nuclear_norm(view(N)); });
    parts.def("moreau",
              [](In<2> M, In<2> N, double step, In<2> dN, double sigma, double t,
                 Out<1> total) -> double {
                  return level().parts.moreau({view(M), view(N), view(dN), step, sigma, t},
                                              view(total));
              });
    parts.def("derivative",
              [](In<1> argument, double t, double sigma, bool resolvent, In<2> atom, In<1> moved,
                 Out<1> prox, Out<1> weighted, Out<2> rows) -> long {
                  return level().parts.derivative({view(argument), view(moved), t, sigma, resolvent,
                                                   view(atom), view(prox), view(weighted),
                                                   view(rows)});
              });
    parts.def("solve_gram",
              [](In<2> F, In<1> f, In<1> r, In<2> C, double shift, bool by_rows, Out<1> x) {
                  level().parts.solve_gram({view(F), view(f), view(r), view(C), shift, by_rows},
                                           view(x));
              });
    parts.def("curvature",
              [](In<1> omega, In<2> curvature, Out<2> rows, Out<2> matrix) {
                  level().parts.curvature(view(omega), view(curvature), view(rows), view(matrix));
              });
    parts.def("reduce", [](In<2> X, In<1> omega, Out<2> out) -> long {
        return level().parts.reduce(view(X), view(omega), view(out));
    });
    parts.def("expand", [](In<2> y, In<1> omega, Out<2> out) -> long {
        return level().parts.expand(view(y), view(omega), view(out));
    });
    parts.def("soft_squared",
              [](In<2> E, In<2> Y, double step, In<2> D, In<1> rho, double threshold) -> double {
                  return level().parts.soft_squared(
                      {view(E), view(Y), view(D), view(rho), step, threshold});
              });
}

}  // namespace

void bind_convex(nb::module_& module, nb::module_& parts) {
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

    bind_convex_parts(parts);
}

}  // namespace shapefit
