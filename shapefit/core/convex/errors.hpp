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

// The functions of SparseErrors, for a loss that has none.
struct NoErrors {
    static constexpr bool robust = false;
    void begin(double, const double*, Index) {}
    double value(double) const { return 0; }
    ErrorsPoint find(double*, Index) { return {}; }
    double penalty(const double*, Index, bool) { return 0; }
    void set_direction(const double*, Index) {}
    void step(double) {}
    void accept() {}
    Index count_curved() { return 0; }
    void append_rows(Index, ShiftedGram&) const {}
    void write_matrix(double, double*) const {}
};

// The sparse errors E of one image after another, with the dual Y and a direction D of
// it.
class SparseErrors {
  public:
    static constexpr bool robust = true;

    SparseErrors(Workspace& workspace, Index p);

    // Begin with an image: its reduction, bounds (p,), and E (2, p) of all landmarks,
    // which is overwritten.
    void attach(const Reduction& reduction, const double* bounds, double* E);

    // Set Y (2, p) to the dual y (2, q), expanded to all landmarks, and rho_j to
    // threshold / bound_j.
    void begin(double threshold, const double* y, Index q);
    // 1/2 sum_aj soft(E_aj + rho_j (Y_aj + step D_aj))^2 / rho_j along the direction D.
    double value(double step) const;
    // Find fresh E = soft(E + rho Y), and add it, reduced, to the gradient g (2, q);
    // returns how far E moves, and how close Y is to its bounds.
    ErrorsPoint find(double* g, Index q);
    // The loss sum_aj bound_j |fresh E_aj|. Without a quadratic the errors are what
    // makes the fit exact, fresh E less the gradient g (2, q), expanded likewise.
    double penalty(const double* g, Index q, bool quadratic);
    // Set D (2, p) to the direction d (2, q), expanded to all landmarks.
    void set_direction(const double* d, Index q);
    // Y += length D.
    void step(double length);
    // E <- fresh E.
    void accept();

    // The second derivative over y is K = sum_am c_am f f^T, with c (2, p) of the
    // visible landmarks in turn: rho_j where fresh E_aj is not 0, else 0. f = e_m - h_m
    // h is row m of the reflection without its last entry, placed in the half of axis
    // a.

    // Find c; returns how many entries are not 0.
    Index count_curved();
    // Write rows sqrt(c_am) f for c_am > 0 to F, from row `first` on.
    void append_rows(Index first, ShiftedGram& gram) const;
    // C (n, n) = shift I + K.
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
