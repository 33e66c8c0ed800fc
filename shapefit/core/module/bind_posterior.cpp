// The posterior over shape and view as a Python function.
#include "../kernels.hpp"
#include "arrays.hpp"
#include "module.hpp"
#include "threads.hpp"

namespace shapefit {

using nb::literals::operator""_a;

void bind_posterior(nb::module_& module) {
    module.def(
        "find_posterior",
        [](In<3> landmarks, In<3> slopes, In<2> misfit, In<4> noise, In<1> log_weights,
           In<3> means, In<3> covariances, In<4> starts, double chance, double density,
           long max_rounds, Out<3> mean, Out<3> deviation, Out<3> correlation, Out<3> covariance,
           Out<2> belief, Out<3> rotation, Out<1> scale, Out<1> log_evidence,
           Out<1> surprise, OutIndices<1> rounds, OutIndices<2> mode_component,
           Out<4> mode_rotation, Out<2> mode_scale, Out<2> mode_log_evidence, Out<4> mode_mean,
           Out<4> mode_covariance, Out<3> mode_belief, int threads) {
            const PosteriorData data{
                view(landmarks),      view(slopes),
                view(misfit),         view(noise),
                view(log_weights),    view(means),          view(covariances),
                view(starts),         chance,               density,
                max_rounds,           view(mean),           view(deviation),
                view(correlation),    view(covariance),     view(belief),         view(rotation),
                view(scale),          view(log_evidence),
                view(surprise),       view(rounds),         view(mode_component),
                view(mode_rotation),  view(mode_scale),     view(mode_log_evidence),
                view(mode_mean),      view(mode_covariance), view(mode_belief)};
            const nb::gil_scoped_release released;
            run_stretches(data.landmarks.size[0], threads,
                          [&](Range range) { level().kernels.find_posterior(data, range); });
        },
        nb::kw_only(), "landmarks"_a, "slopes"_a, "misfit"_a, "noise"_a, "log_weights"_a, "means"_a,
        "covariances"_a, "starts"_a, "chance"_a, "density"_a, "max_rounds"_a, "mean"_a,
        "deviation"_a, "correlation"_a, "covariance"_a, "belief"_a, "rotation"_a, "scale"_a, "log_evidence"_a, "surprise"_a, "rounds"_a,
        "mode_component"_a, "mode_rotation"_a, "mode_scale"_a, "mode_log_evidence"_a, "mode_mean"_a,
        "mode_covariance"_a, "mode_belief"_a, "threads"_a);
}

}  // namespace shapefit
