// Single steps of the search with arrays, for tests.
#pragma once

#include "data.hpp"

namespace shapefit {

// The 600-cell modulo sign: quaternions (60, 4) and the vertices of each cell (300, 4).
void root_cells(Matrix<double> vertices, Matrix<int64_t> cells);

// Whether the cell can be dropped; excess (20,) of the coefficients over their bounds, all nan where
// a vertex does not reach the cut.
bool judge_alone(const CellData& cell);

// Descend from the quaternion q; returns the objective there.
double descend_alone(const DescentData& data);

}  // namespace shapefit
