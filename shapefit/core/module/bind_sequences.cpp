// The inference over sequences as Python functions.
#include "../kernels.hpp"
#include "arrays.hpp"
#include "module.hpp"
#include "threads.hpp"

namespace shapefit {

using nb::literals::operator""_a;

void bind_sequences(nb::module_& module) {
    module.def(
        "find_precisions",
        [](Out<4> matrices, InFlags<2> there, In<2> more, Out<2> log_det, int threads) {
            const PrecisionData data{view(matrices), view(there), view(more), view(log_det)};
            const nb::gil_scoped_release released;
            run_stretches(data.there.size[0], threads,
                          [&](Range range) { level().kernels.find_precisions(data, range); });
        },
        nb::kw_only(), "matrices"_a, "there"_a, "more"_a, "log_det"_a, "threads"_a);
    module.def(
        "smooth_sequence",
        [](In<2> landmarks, In<2> weight, In<2> log_share, In<3> means, In<4> precisions,
           In<2> log_det, In<1> stiffness, InIndices<2> bones, In<1> rigidity, In<1> hold,
           In<1> known, long most_rounds, double still, Out<2> points, Out<1> lengths,
           Out<2> deviation, Out<2> correlation, Out<3> covariance, Out<1> end) {
            const SequenceData data{view(landmarks), view(weight),     view(log_share),
                                    view(means),     view(precisions), view(log_det),
                                    view(stiffness), view(bones),      view(rigidity),
                                    view(hold),      view(known),      most_rounds,
                                    still,           view(points),     view(lengths),
                                    view(deviation), view(correlation), view(covariance),
                                    view(end)};
            const nb::gil_scoped_release released;
            level().kernels.smooth_sequence(data);
        },
        nb::kw_only(), "landmarks"_a, "weight"_a, "log_share"_a, "means"_a, "precisions"_a,
        "log_det"_a, "stiffness"_a, "bones"_a, "rigidity"_a, "hold"_a, "known"_a, "most_rounds"_a,
        "still"_a, "points"_a, "lengths"_a, "deviation"_a, "correlation"_a, "covariance"_a, "end"_a);
}

}  // namespace shapefit
