// The posterior over shape and view of each image, its modes combined.
#pragma once

#include "data.hpp"

namespace shapefit {

// Climb from every start under every component; weigh the maxima by their evidence, the view
// integrated out by Laplace's approximation; mean and covariance of the mixture of those that count.
void find_posterior(const PosteriorData& data, Range range);

}  // namespace shapefit
