// The products B_i B_j^T (3, 3) of pairs of atoms, of one image after another.
#pragma once

#include "reduced_atoms.hpp"

namespace shapefit {

// Each product of atoms in use is made once for a set of weights. An atom has a place
// here: where all places are taken, all are given up.
class AtomProducts {
  public:
    AtomProducts(Workspace& workspace, Index k);

    // Forget all products, as the atoms have changed.
    void clear() { ++generation_, taken_ = 0; }

    // Compute the missing products among the atoms `used` (count,); false where there
    // are more of them than places.
    bool make(ReducedAtoms& atoms, const Index* used, Index count);

    // The place of atom i, after `make`.
    Index place(Index i) const { return place_[i]; }

    // The products of atom i with all others, (9, places): entry (b, c) of B_i B_j^T is
    // in row 3 b + c, column `place(j)`.
    const double* with(Index i) const { return products_ + 9 * place_[i] * places_; }
    // How many atoms have a place at most.
    Index places() const { return places_; }

  private:
    // Whether atom i has a place, with its products.
    bool has(Index i) const { return made_for_[i] == generation_; }
    // Give atom i the next place, and compute its products with all that have one.
    void add(ReducedAtoms& atoms, Index i);

    Index places_, taken_ = 0, generation_ = 1;
    Index *place_, *made_for_;  // (k,)
    Index* atom_;               // (places,) the atom of each place
    double* products_;          // (places, 9, places)
};

}  // namespace shapefit
