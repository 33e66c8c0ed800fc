// The kernels of lifting as Python functions.
#include "../kernels.hpp"
#include "arrays.hpp"
#include "module.hpp"
#include "threads.hpp"

namespace shapefit {

using nb::literals::operator""_a;

namespace {

void bind_lifting_parts(nb::module_& parts) {
    const Parts& part = level().parts;
    parts.def("climb", [&part](In<3> blocks, Out<2> R) -> double { return part.climb(view(blocks), view(R)); });
    parts.def("polar_rotation",
              [&part](In<2> A, Out<2> R) -> bool { return part.polar_rotation(view(A), view(R)); });
    parts.def("scaled_coefficients", [&part](In<2> Q, In<1> h, In<1> a, Out<1> x) {
        part.scaled_coefficients(view(Q), view(h), view(a), view(x));
    });
    parts.def("sparse_coefficients",
              [&part](In<2> w, In<3> atoms, In<2> R, double lam, bool is_signed, Out<1> c) -> double {
                  return part.sparse_coefficients(view(w), view(atoms), view(R), lam, is_signed, view(c));
              });
    parts.def("alternate_image",
              [&part](In<2> w, In<3> atoms, double lam, bool is_signed, double tolerance, Out<2> R,
                      Out<1> c, Out<1> trace) -> nb::tuple {
                  const AlternationEnd end = part.alternate_image(
                      view(w), view(atoms), lam, is_signed, tolerance, view(R), view(c), view(trace));
                  return nb::make_tuple(end.steps, end.converged);
              });
    parts.def("rotation_step", [&part](In<2> P, In<2> D, bool free_scale, Out<2> R) -> nb::tuple {
        const Misfit misfit = part.rotation_step(view(P), view(D), free_scale, view(R));
        return nb::make_tuple(misfit.value, misfit.scale);
    });
    parts.def("rotation_value", [&part](In<2> P, In<2> D, bool free_scale, In<2> R) -> double {
        return part.rotation_value(view(P), view(D), free_scale, view(R));
    });
    parts.def("rotation_model",
              [&part](In<2> P, In<2> D, bool free_scale, In<2> R, Out<1> g, Out<2> H) -> nb::tuple {
                  const Misfit misfit =
                      part.rotation_model(view(P), view(D), free_scale, view(R), view(g), view(H));
                  return nb::make_tuple(misfit.value, misfit.scale);
              });
    parts.def("truncated_cg", [&part](In<1> g, In<2> H, double radius, Out<1> step) -> nb::tuple {
        const TrustedStep trusted = part.truncated_cg(view(g), view(H), radius, view(step));
        return nb::make_tuple(trusted.at_edge, trusted.fall);
    });
    parts.def("retract", [&part](In<2> R, In<1> step, Out<2> out) {
        part.retract(view(R), view(step), view(out));
    });
    parts.def("orthonormalise", [&part](Out<2> R) { part.orthonormalise(view(R)); });
}

}  // namespace

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

    module.def(
        "find_pose",
        [](In<3> shape_moments, In<3> landmarks_by_shape, In<4> starts, Out<3> rotation, Out<1> size,
           int threads) {
            const PoseData data{view(shape_moments), view(landmarks_by_shape), view(starts),
                                view(rotation), view(size)};
            const nb::gil_scoped_release released;
            run_stretches(data.size.size[0], threads,
                          [&](Range range) { level().kernels.find_pose(data, range); });
        },
        nb::kw_only(), "shape_moments"_a, "landmarks_by_shape"_a, "starts"_a, "rotation"_a, "size"_a,
        "threads"_a);

    module.def(
        "alternate",
        [](In<3> landmarks, In<2> weights, In<3> atoms, In<1> lam, In<4> starts, bool is_signed,
           double tolerance, long most_rounds, Out<2> coefficients, Out<3> rotation,
           OutIndices<1> rounds, OutIndices<1> status, int threads) {
            const AlternationData data{
                .landmarks = view(landmarks),
                .weights = view(weights),
                .atoms = view(atoms),
                .lam = view(lam),
                .starts = view(starts),
                .is_signed = is_signed,
                .tolerance = tolerance,
                .most_rounds = most_rounds,
                .coefficients = view(coefficients),
                .rotation = view(rotation),
                .rounds = view(rounds),
                .status = view(status),
            };
            const nb::gil_scoped_release released;
            run_stretches(data.landmarks.size[0], threads,
                          [&](Range range) { level().kernels.alternate(data, range); });
        },
        nb::kw_only(), "landmarks"_a, "weights"_a, "atoms"_a, "lam"_a, "starts"_a, "is_signed"_a,
        "tolerance"_a, "most_rounds"_a, "coefficients"_a, "rotation"_a, "rounds"_a, "status"_a,
        "threads"_a);

    bind_lifting_parts(parts);
}

}  // namespace shapefit
