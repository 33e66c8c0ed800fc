// The sparse errors E of the robust losses, as a part of the augmented Lagrangian.
//
//     |Y| <= bound   becomes the term
//     sum_j 1/(2 rho_j) ||soft_{rho_j bound_j}(E_j + rho_j Y_j)||^2,
//     soft_t(x) = sign(x) max(|x| - t, 0)
//
// for columns E_j and Y_j. rho_j bound_j is the same for all j, so that the steps of E
// and M fit the sizes of both, whatever the bounds and lambda. NoErrors is the same
// part where no bound is set.
#pragma once

#include "blocks.hpp"

namespace shapefit {

// What a proximal point says of the errors.
struct ErrorsPoint {
    double moved = 0;  // ||fresh E - E||^2
    double share = 0;  // max |Y_j| / bound_j
};

struct NoErrors {
    static constexpr bool robust = false;
    void begin(double, const double*, Index) {}
    double value(double) const { return 0; }
    ErrorsPoint find(double*, Index) { return {}; }
    double penalty(const double*, Index, bool) { return 0; }
    void aim(const double*, Index) {}
    void step(double) {}
    void accept() {}
    Index count_curved() { return 0; }
    void append_rows(Index, ShiftedGram&) const {}
    void write_matrix(double, double*) const {}
};

class SparseErrors {
  public:
    static constexpr bool robust = true;

    SparseErrors(Workspace& workspace, Index p);

    // Turn to an image: its E (2, p) in landmark space, overwritten, and bounds (p,).
    void attach(const Reduction& reduction, const double* bounds, double* E);

    // Take up y (2, q), with rho_j bound_j = threshold.
    void begin(double threshold, const double* y, Index q);
    // 1/2 sum_aj soft(E_aj + rho_j (Y_aj + step D_aj))^2 / rho_j along the aim D.
    double value(double step) const;
    // fresh E = soft(E + rho Y), reduced and added to the gradient g (2, q).
    ErrorsPoint find(double* g, Index q);
    // The loss bound |fresh E|, with what the gradient leaves of the landmarks where no
    // quadratic takes it.
    double penalty(const double* g, Index q, bool quadratic);
    // Set D to the direction d (2, q) of y.
    void aim(const double* d, Index q);
    // Y += length D.
    void step(double length);
    // E <- fresh E.
    void accept();

    // The second derivative sum_am c_am f f^T, c (2, p) of the visible landmarks in
    // turn: rho_j at those of fresh errors. f = e_m - h_m h is row m of the reflection
    // without its last entry, placed in the half of axis a. As rows sqrt(c_am) f where
    // c_am > 0, from row `first` on; and as a matrix shift I + it (n, n).
    Index count_curved();
    void append_rows(Index first, ShiftedGram& gram) const;
    void write_matrix(double shift, double* C) const;

  private:
    Index p_;
    const Reduction* reduction_ = nullptr;
    const double* bounds_ = nullptr;
    double* E_ = nullptr;
    double threshold_ = 0;
    double *Y_, *D_, *fresh_;  // (2, p)
    double* rho_;              // (p,)
    double* curvature_;        // (2, p), of the visible landmarks in turn
};

}  // namespace shapefit
