// The Newton system of few rows and many unknowns, without its rows.
//
//     (shift I + F^T F) x = r + F^T f
//
// is, in the space of the rows (Woodbury),
//
//     x = (r - F^T s) / shift,    (shift I + F F^T) s = F r - shift f.
//
// A row of F is a direction T (2, 3) of a block, times its atom: row (t, d) is T_td
// B_d. So all that is needed of F is in products of atoms, whatever the unknowns are:
//
//     (F F^T)_(t c)(u d) = <T_tc, T_ud (B_d B_c^T)>,    (F r)_(t d) = <T_td, r B_d^T>,
//     F^T s = sum_d (sum_t s_td T_td) B_d.
#pragma once

#include "../atoms/atom_products.hpp"
#include "blocks.hpp"
#include "gram.hpp"

namespace shapefit {

// The system in the space of the rows, of one image after another.
class RowSystem {
  public:
    RowSystem(Workspace& workspace, Index padded_atoms);

    // Forget all products of atoms, as these have changed.
    void clear() { products_.clear(); }

    // Solve (shift I + F^T F) x = r + F^T f for x (2, q), with F and f of the
    // directions of the active blocks. False, with x as it was, where the system is
    // solved faster with the rows written.
    bool solve(const ActiveBlocks& active, double shift, const double* r, double* x,
               ReducedAtoms& atoms, ShiftedGram& gram);

  private:
    // The number of rows of F.
    Index rows() const { return 4 * blocks_ + 2 * wide_; }
    // The number of blocks that have a direction, 0 .. 5.
    Index blocks_with(int direction) const { return direction < 4 ? blocks_ : wide_; }
    // Entry e of a direction (2, 3) for all blocks; e = 6: its right-hand side.
    double* entry(int direction, int e) const {
        return directions_ + (7 * direction + e) * capacity_;
    }

    void sort_blocks(const ActiveBlocks& active);
    void copy_directions(const ActiveBlocks& active);
    void find_right_side(double shift, const double* r, ReducedAtoms& atoms);
    void add_products_of(Index c, ShiftedGram& gram);
    void add_products_with(int u, Index first, double* row) const;
    void turn_products(int direction, Index c);
    void expand(double shift, const double* r, double* x, ReducedAtoms& atoms) const;

    const Index capacity_;
    AtomProducts products_;
    Index blocks_ = 0, wide_ = 0;
    Index *order_,
        *atom_;  // the blocks as rows have them: those of six directions first
    Index first_[6] = {};  // row of each direction
    double* directions_;   // (6, 7, capacity): T and f
    double* product_;      // (9, capacity): B_c B_d^T of a block c with all d
    double* turned_;       // (6, capacity): T_tc B_c B_d^T
    double* s_;            // (6 capacity,)
};

}  // namespace shapefit
