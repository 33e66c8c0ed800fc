// The way up to a maximum of the likelihood over the view, one start and component a lane.
#pragma once

#include "likelihood.hpp"

namespace shapefit::SHAPEFIT_LEVEL {

struct Climb {
    Climb(Workspace& workspace, long p);

    LaneView view;
    Lanes* belief;  // (m,)
    Likelihood found;
    Lanes hessian[VIEW * VIEW];  // of -value at the end, symmetric

    LaneView tried;
    Lanes *next, *tried_belief, *tried_next;  // (m,)
    Likelihood there;
};

// Steps of Newton's kind, whose curvature is Gauss and Newton's, mended by what the gradient does
// (Broyden, Fletcher, Goldfarb, Shanno); damped where they would lead downhill. Every lane climbs
// from `view` until it stands still, or its value and what it can still gain stay far below
// `hopeless`. Returns the steps taken.
long climb(const PosteriorData& data, const Observed& seen, const Pack& pack, Lanes log_weight,
           double& best, const LikelihoodSpace& space, Climb& climb);

// The Hessian at the end by differences of gradients, the belief held.
void measure_hessian(const PosteriorData& data, const Observed& seen, const Pack& pack,
                     const LikelihoodSpace& space, Climb& climb);

}  // namespace shapefit::SHAPEFIT_LEVEL
