// The precisions of the modes of images.
#pragma once

#include "data.hpp"

namespace shapefit {

// C -> (C + more I)^-1 with log det (C + more I); nan where that is not positive definite.
void find_precisions(const PrecisionData& data, Range range);

}  // namespace shapefit
