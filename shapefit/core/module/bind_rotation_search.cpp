// The search over all rotations as Python functions.
#include "../kernels.hpp"
#include "arrays.hpp"
#include "module.hpp"
#include "threads.hpp"

namespace shapefit {

using nb::literals::operator""_a;

namespace {

void bind_rotation_search_parts(nb::module_& parts) {
    parts.def("root_cells", [](Out<2> vertices, OutIndices<2> cells) {
        level().parts.root_cells(view(vertices), view(cells));
    });
    parts.def("judge_cell",
              [](In<3> W, In<2> omega, In<3> atoms, In<1> lam, bool is_signed, In<2> corners, double cut,
                 Out<1> excess) -> bool {
                  const SearchProblem problem{view(W), view(omega), view(atoms), view(lam), is_signed};
                  return level().parts.judge_cell({problem, view(corners), cut}, view(excess));
              });
    parts.def("descend",
              [](In<3> W, In<2> omega, In<3> atoms, In<1> lam, bool is_signed, Out<1> q,
                 double share) -> double {
                  const SearchProblem problem{view(W), view(omega), view(atoms), view(lam), is_signed};
                  return level().parts.descend(problem, view(q), share);
              });
}

}  // namespace

void bind_rotation_search(nb::module_& module, nb::module_& parts) {
    module.def(
        "find_optimum",
        [](In<3> landmarks, In<2> weights, In<3> atoms, In<1> lam, bool is_signed, In<4> starts,
           double tolerance, long most_cells, double most_seconds, Out<2> coefficients,
           Out<3> rotation, Out<1> objective, Out<1> bound, OutIndices<1> cells,
           OutIndices<1> vertices, OutIndices<1> status, int threads) {
            const GlobalData data{
                .problem = {view(landmarks), view(weights), view(atoms), view(lam), is_signed},
                .starts = view(starts),
                .tolerance = tolerance,
                .limits = {most_cells, most_seconds},
                .coefficients = view(coefficients),
                .rotation = view(rotation),
                .objective = view(objective),
                .bound = view(bound),
                .cells = view(cells),
                .vertices = view(vertices),
                .status = view(status),
            };
            const nb::gil_scoped_release released;
            run_stretches(data.problem.landmarks.size[0], threads,
                          [&](Range range) { level().kernels.find_optimum(data, range); });
        },
        nb::kw_only(), "landmarks"_a, "weights"_a, "atoms"_a, "lam"_a, "is_signed"_a, "starts"_a,
        "tolerance"_a, "most_cells"_a, "most_seconds"_a, "coefficients"_a, "rotation"_a,
        "objective"_a, "bound"_a, "cells"_a, "vertices"_a, "status"_a, "threads"_a);

    module.def(
        "find_modes",
        [](In<3> landmarks, In<2> weights, In<3> atoms, In<1> lam, bool is_signed, In<3> best,
           double within, double apart, long most_cells, double most_seconds, Out<4> rotation,
           Out<2> objective, OutIndices<1> count, OutIndices<1> valleys, OutIndices<1> cells,
           OutIndices<1> status, int threads) {
            const ModesData data{
                .problem = {view(landmarks), view(weights), view(atoms), view(lam), is_signed},
                .best = view(best),
                .within = within,
                .apart = apart,
                .limits = {most_cells, most_seconds},
                .rotation = view(rotation),
                .objective = view(objective),
                .count = view(count),
                .valleys = view(valleys),
                .cells = view(cells),
                .status = view(status),
            };
            const nb::gil_scoped_release released;
            run_stretches(data.problem.landmarks.size[0], threads,
                          [&](Range range) { level().kernels.find_modes(data, range); });
        },
        nb::kw_only(), "landmarks"_a, "weights"_a, "atoms"_a, "lam"_a, "is_signed"_a, "best"_a,
        "within"_a, "apart"_a, "most_cells"_a, "most_seconds"_a, "rotation"_a, "objective"_a,
        "count"_a, "valleys"_a, "cells"_a, "status"_a, "threads"_a);

    module.def(
        "find_coefficients",
        [](In<3> landmarks, In<2> weights, In<3> atoms, In<1> lam, bool is_signed, In<3> rotation,
           Out<2> coefficients, Out<1> objective, int threads) {
            const CoefficientsData data{
                .problem = {view(landmarks), view(weights), view(atoms), view(lam), is_signed},
                .rotation = view(rotation),
                .coefficients = view(coefficients),
                .objective = view(objective),
            };
            const nb::gil_scoped_release released;
            run_stretches(data.problem.landmarks.size[0], threads,
                          [&](Range range) { level().kernels.find_coefficients(data, range); });
        },
        nb::kw_only(), "landmarks"_a, "weights"_a, "atoms"_a, "lam"_a, "is_signed"_a, "rotation"_a,
        "coefficients"_a, "objective"_a, "threads"_a);

    module.def(
        "record_tree",
        [](In<3> landmarks, In<2> weights, In<3> atoms, In<1> lam, bool is_signed, double cut,
           long most_cells, Out<2> vertices, Out<3> multipliers, OutIndices<1> splits) -> nb::tuple {
            const TreeData data{
                .problem = {view(landmarks), view(weights), view(atoms), view(lam), is_signed},
                .cut = cut,
                .most_cells = most_cells,
                .vertices = view(vertices),
                .multipliers = view(multipliers),
                .splits = view(splits),
            };
            TreeSize size{};
            {
                const nb::gil_scoped_release released;
                size = level().kernels.record_tree(data);
            }
            return nb::make_tuple(size.cells, size.vertices, size.complete);
        },
        nb::kw_only(), "landmarks"_a, "weights"_a, "atoms"_a, "lam"_a, "is_signed"_a, "cut"_a,
        "most_cells"_a, "vertices"_a, "multipliers"_a, "splits"_a);

    bind_rotation_search_parts(parts);
}

}  // namespace shapefit
