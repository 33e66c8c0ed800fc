// Descent of v(R) from a rotation to a local minimum: BFGS in the turns of the camera frame.
#pragma once

#include "objective.hpp"

namespace shapefit {

constexpr double FINE = 1e-13;  // share of v that a step of a last descent must promise

// Take the unit quaternion q downhill until a step promises a fall of at most `share` of v, or none
// is found; returns v there. The coefficients of the objective are the start and those of the end.
double descend(RotationObjective& objective, double* q, double share);

}  // namespace shapefit
