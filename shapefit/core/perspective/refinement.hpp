// Refinement of pose and coefficients under a full perspective projection, image after image.
#pragma once

#include "data.hpp"

namespace shapefit {

// Levenberg-Marquardt steps until the objective settles. The softness halves from 1 to its last
// value, so that many landmarks pull while the pose is still coarse. DEGENERATE where a landmark
// begins behind the camera: no step is taken from there.
void refine_perspective(const PerspectiveData& data, Range range);

}  // namespace shapefit
