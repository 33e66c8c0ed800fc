// The way up to a maximum of the likelihood over the view, one start and component a lane.
#pragma once

#include "likelihood.hpp"

namespace shapefit::SHAPEFIT_LEVEL {

// Where the lanes of a block stand. A block is an array of Lanes, and lanes can move between blocks:
// these, then the belief (m,) and the next one (m,).
struct Climb {
    LaneView view;
    Likelihood found;
    Lanes curvature[VIEW * VIEW];  // Gauss and Newton's, mended; at the end the Hessian of -value
    Lanes damping;
    Lanes moving;  // 1, or 0 where a lane has arrived
    Lanes hope;    // what the next step is expected to gain

    Lanes* belief() { return reinterpret_cast<Lanes*>(this + 1); }
    Lanes* next(long m) { return belief() + m; }
};

constexpr long climb_size(long p) { return sizeof(Climb) / sizeof(Lanes) + 2 * p; }

struct ClimbSpace {
    ClimbSpace(Workspace& workspace, long p);

    LikelihoodSpace likelihood;
    LaneView view;
    Likelihood found;
    Lanes *belief, *next;  // (m,)
};

// The first values, at the views where the lanes start; beliefs come from the other landmarks.
void begin(const PosteriorData& data, const Observed& seen, const Pack& pack, ClimbSpace& space,
           Climb& at);

// Steps of Newton's kind, whose curvature is Gauss and Newton's, mended by what the gradient does
// (Broyden, Fletcher, Goldfarb, Shanno); damped where they would lead downhill. A lane that stands
// still has arrived.
void climb(const PosteriorData& data, const Observed& seen, const Pack& pack, long rounds,
           ClimbSpace& space, Climb& at);

// The Hessian at the end by differences of gradients, the belief held, and Newton's last step.
void finish(const PosteriorData& data, const Observed& seen, const Pack& pack, ClimbSpace& space,
            Climb& at);

}  // namespace shapefit::SHAPEFIT_LEVEL
