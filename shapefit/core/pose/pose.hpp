// The pose of one known shape in each image: rotation and scale, the best of several starts.
#pragma once

#include "../shared/data.hpp"

namespace shapefit {

// argmin 1/2 ||w - s Rbar S||_F^2 over rotations and s >= 0, for the images of the range.
void find_pose(const PoseData& data, Range range);

// P and D; zero for an image without landmarks.
void find_shape_moments(const MomentsData& data, Range range);

// The turn by atan2(A_10 - A_01, A_00 + A_11), A = D Rbar^T.
void turn_in_plane(const ViewsData& data, Range range);

}  // namespace shapefit
