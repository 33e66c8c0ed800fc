// The atom update: better atoms within a ball for fixed coefficients, by block coordinate descent.
#pragma once

#include "data.hpp"

namespace shapefit {

// A += C^T C, D += C^T X, shape by shape: the sums do not depend on where batches of shapes end.
void add_products(const ProductsData& data);

// Lower 1/2 ||X - C B||_F^2 over the rows of B within the ball ||B_i|| <= bound:
//
//   A = C^T C,  D = C^T X,  B_i <- projection of  B_i + (D_i - sum_l A_il B_l) / A_ii  on the ball,
//
// one atom after another, `sweeps` times. Atoms that no shape uses stay as they are.
void update_atoms(const AtomUpdateData& data);

}  // namespace shapefit
