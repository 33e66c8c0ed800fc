// The global optimum of each image with its certificate.
#pragma once

#include "data.hpp"

namespace shapefit {

// Search all rotations for the images of the range; see docs/global.md.
void find_optimum(const GlobalData& data, Range range);

}  // namespace shapefit
