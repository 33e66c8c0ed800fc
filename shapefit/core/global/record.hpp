// The tree of one image's search with the multipliers of its vertices, for a file.
#pragma once

#include "data.hpp"

namespace shapefit {

// Search one image with a fixed cut and write what fits into the arrays.
TreeSize record_tree(const TreeData& data);

}  // namespace shapefit
