// All readings of each image, and the proof that there is none besides.
#pragma once

#include "objective.hpp"

namespace shapefit {

// List the modes of the images of the range.
//
// Every rotation whose objective is at most (1 + within) times the least lies within `apart` of a
// minimum that was found, or of a rotation from which the descent ends at one: its valley. Of
// minima that are not `apart` the best one is listed.
void find_modes(const ModesData& data, Range range);

}  // namespace shapefit
