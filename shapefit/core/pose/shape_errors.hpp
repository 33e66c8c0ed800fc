// How far estimated shapes are from the true ones, image by image.
#pragma once

#include "errors_data.hpp"

namespace shapefit {

// min over s, proper R, t of sum_j |s R e_j + t - x_j|^2; then the mean over j of that distance.
//
// Where the points of e are one, s = 1; where those of x are, s = 0 (Umeyama, 1991).
void find_similarity_errors(const SimilarityData& data, Range range);

// min over s >= 0, t of sum_j |s e_j + t - R x_j|^2; then the mean over j of that distance.
void find_camera_errors(const CameraData& data, Range range);

// The mean over the axes of the standard deviation of x.
void find_spread(const SpreadData& data, Range range);

}  // namespace shapefit
