// A stretch of images, each solved from its neighbour's solution where that explains it.
#pragma once

#include "data.hpp"

namespace shapefit::SHAPEFIT_LEVEL {

// Solve the images of the range in turn, stretch by stretch, and certify each. Where the options say `started`, the
// point holds a start for each image, which takes the place of the neighbour's.
void solve_convex(const ConvexTask& task, Range range);

}  // namespace shapefit::SHAPEFIT_LEVEL
