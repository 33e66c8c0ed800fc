// A stretch of images, each solved from its neighbour's solution where that explains it.
#pragma once

#include "data.hpp"

namespace shapefit {

// Solve the images of the range in turn, stretch by stretch, and certify each.
void solve_convex(const ConvexTask& task, Range range);

}  // namespace shapefit
