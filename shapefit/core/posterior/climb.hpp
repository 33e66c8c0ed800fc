// The way up to a maximum of the likelihood over the view, one start and component a lane.
#pragma once

#include "likelihood.hpp"

namespace shapefit {

// Where the lanes of a block stand. A block is an array of Doubles, and lanes can move between blocks:
// these, then the belief (m,) and the next one (m,).
template <class Lanes>
struct Climb {
    LaneView<Lanes> view;
    Likelihood<Lanes> found;
    Lanes curvature[VIEW * VIEW];  // Gauss and Newton's, mended; at the end the Hessian of -value
    Lanes damping;
    Lanes moving;  // 1, or 0 where a lane has arrived
    Lanes hope;    // what the next step is expected to gain
    Lanes largest;  // log of the scale beyond which no step goes

    Lanes* belief() { return reinterpret_cast<Lanes*>(this + 1); }
    Lanes* next(long m) { return belief() + m; }
};

template <class Lanes>
constexpr long climb_size(long p) {
    return sizeof(Climb<Lanes>) / sizeof(Lanes) + 2 * p;
}

template <class Lanes>
struct ClimbSpace {
    ClimbSpace(Workspace& workspace, long p);

    LikelihoodSpace<Lanes> likelihood;
    LaneView<Lanes> view;
    Likelihood<Lanes> found;
    Lanes *belief, *next;  // (m,)
};

// The first values, at the views where the lanes start; beliefs come from the other landmarks.
template <class Lanes>
void begin(const PosteriorData& data, const Observed<Number<Lanes>>& seen, const Pack<Lanes>& pack, ClimbSpace<Lanes>& space,
           Climb<Lanes>& at);

// Steps of Newton's kind, whose curvature is Gauss and Newton's, mended by what the gradient does
// (Broyden, Fletcher, Goldfarb, Shanno); damped where they would lead downhill. A lane that stands
// still has arrived. Where every landmark is gross the likelihood grows with the scale for ever: there
// steps end at `largest`.
template <class Lanes>
void climb(const PosteriorData& data, const Observed<Number<Lanes>>& seen, const Pack<Lanes>& pack, long rounds,
           ClimbSpace<Lanes>& space, Climb<Lanes>& at);

// The Hessian at the end by differences of gradients, the belief held, and Newton's last step. A lane
// is still moving where that step is not small: it stands on no stationary point.
template <class Lanes>
void finish(const PosteriorData& data, const Observed<Number<Lanes>>& seen, const Pack<Lanes>& pack, ClimbSpace<Lanes>& space,
            Climb<Lanes>& at);

}  // namespace shapefit
