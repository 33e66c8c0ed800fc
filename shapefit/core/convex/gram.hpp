// The Newton system
//
//     (C + F^T F) x = r + F^T f
//
// by L D L^T = C + F^T F or, for C = shift I and an F of few rows, in the space of the
// rows (Woodbury):
//
//     x = (r - F^T s) / shift,    (shift I + F F^T) s = F r - shift f.
#pragma once

#include "../base/lanes.hpp"
#include "../base/memory.hpp"

namespace shapefit {

// One factorisation L D L^T of C + F^T F, with r + F^T f as one more column.
struct GramSystem {
    const double* F;  // (rows, stride), f in column `columns`
    Index rows, stride, columns;
    double* factor;   // C and r at first, then D L^T: (columns, factor_stride)
    double* scaled;   // L^T
    double* inverse;  // 1 / D
    double* least;    // what pivots are lifted to; null where C >= I
    Index factor_stride;
};

// Room for a matrix F (rows, n) with a column for f, and for its factorisation.
//
// The matrix is taken apart four rows at a time, looking left: F^T F is summed into the
// registers that hold the four rows, so that the Gram matrix is never stored. A large
// one is summed and taken apart by panels of rows that stay in the cache.
class ShiftedGram {
  public:
    ShiftedGram(Workspace& workspace, Index most_rows, Index most_unknowns);

    // Set the number of unknowns, 1 .. most_unknowns; what the rows held is lost.
    void set_unknowns(Index n);
    Index unknowns() const { return n_; }
    // The column of F that holds f.
    Index right_side() const { return tiled_; }
    // Row f of F, which the caller writes, with zeros between the unknowns and the
    // right side.
    double* row(Index f) { return F_ + f * stride_; }
    Index stride() const { return stride_; }

    // Solve (shift I + F^T F) x = r + F^T f for x, shift > 0; x may be r. `by_rows`
    // allows the system to be solved in the space of the rows where these are fewer
    // (Woodbury), which loses digits where the shift is tiny.
    void solve(Index rows, double shift, bool by_rows, const double* r, double* x);

    // Solve (C + F^T F) x = r + F^T f for x, C (n, n) row-major, the sum positive
    // definite.
    void solve(Index rows, const double* C, const double* r, double* x);

    // Set up the system (shift I + G) x = s. The caller then adds row i of G (rows,
    // rows) to `factor_row(i)`, from the diagonal on, and calls `finish`.
    void begin(Index rows, double shift, const double* s);
    double* factor_row(Index i) { return factor_ + i * stride_; }
    // Overwrite s by the solution of the system that `begin` has set up.
    void finish(Index rows, double shift, double* s);

  private:
    GramSystem system(const double* F, Index rows, Index columns, bool lift) const;
    void solve_by_rows(Index rows, double shift, const double* r, double* x);

    Index n_, tiled_, stride_;
    double *F_, *turned_, *factor_, *scaled_, *inverse_, *least_, *small_;
};

}  // namespace shapefit
