// The kernels of the search for outliers as Python functions.
#include "../kernels.hpp"
#include "arrays.hpp"
#include "module.hpp"
#include "threads.hpp"

namespace shapefit {

using nb::literals::operator""_a;

namespace {

void bind_outliers_parts(nb::module_& parts) {
    parts.def("draw_triple",
              [](InIndices<1> candidates, Array<uint64_t, 1> state, OutIndices<1> triple) {
                  level().parts.draw_triple(view(candidates), view(state), view(triple));
              });
    parts.def("pose_triple", [](In<2> w, In<2> S, InIndices<1> triple, Out<3> R) -> double {
        return level().parts.pose_triple(view(w), view(S), view(triple), view(R));
    });
    parts.def("find_area", [](In<2> w, InIndices<1> visible) -> double {
        return level().parts.find_area(view(w), view(visible));
    });
    parts.def("judge",
              [](In<2> w, In<1> h, In<2> S, double s, In<2> R, In<1> T, double threshold,
                 double area, bool lanes, OutFlags<1> inliers) -> double {
                  return level().parts.judge({view(w), view(h), view(S)}, s, view(R), view(T),
                                             threshold, area, lanes, view(inliers));
              });
    parts.def("find_moments",
              [](In<2> w, In<1> h, In<2> S, InFlags<1> inliers, Out<2> P, Out<2> D, Out<1> middle,
                 Out<1> origin) {
                  level().parts.find_moments({view(w), view(h), view(S)}, view(inliers), view(P),
                                             view(D), view(middle), view(origin));
              });
}

}  // namespace

void bind_outliers(nb::module_& module, nb::module_& parts) {
    module.def(
        "find_consensus",
        [](In<3> landmarks, In<2> squares, In<2> shape, Array<const uint64_t, 1> seeds,
           double threshold, long draws, long max_rounds, OutFlags<2> inliers, int threads) {
            const ConsensusData data{view(landmarks), view(squares), view(shape), view(seeds),
                                     threshold,       draws,         max_rounds,  view(inliers)};
            const nb::gil_scoped_release released;
            run_stretches(data.landmarks.size[0], threads,
                          [&](Range range) { level().kernels.find_consensus(data, range); });
        },
        nb::kw_only(), "landmarks"_a, "squares"_a, "shape"_a, "seeds"_a, "threshold"_a, "draws"_a,
        "max_rounds"_a, "inliers"_a, "threads"_a);
    bind_outliers_parts(parts);
}

}  // namespace shapefit
