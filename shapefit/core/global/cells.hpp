// Cells of rotations: cones over four unit quaternions, of which q and -q are one rotation.
//
// The 600-cell has 120 vertices and 600 tetrahedra; modulo sign 60 and 300, which cover all
// rotations. Neighbouring vertices are 72 degrees of rotation apart.
#pragma once

#include "quaternions.hpp"

namespace shapefit {

// Four vertices, by number. Their signs are those of the hemisphere about the first.
struct Cell {
    int vertex[4];
    int passed = 0;  // splits in a row that spared its longest edge
};

constexpr int ROOT_VERTICES = 60, ROOT_CELLS = 300;
constexpr int EDGES = 6;
constexpr int EDGE[EDGES][2] = {{0, 1}, {0, 2}, {0, 3}, {1, 2}, {1, 3}, {2, 3}};

// The 600-cell modulo sign.
struct RootCells {
    RootCells();

    double vertex[ROOT_VERTICES][4];
    Cell cell[ROOT_CELLS];
};

}  // namespace shapefit
