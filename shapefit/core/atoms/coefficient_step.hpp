// The coefficient step: the lasso over the projected atoms Rbar B_i, solved exactly,
//
//     argmin_c 1/2 ||w - sum_i c_i Rbar B_i||_F^2 + lam ||c||_1
//     over all c, or over c >= 0.
//
// At the minimum <Rbar B_i, residual> = sign(c_i) lam where c_i is not 0; elsewhere it
// is at most lam, in magnitude where c may be negative.
#pragma once

#include "../base/active_set.hpp"
#include "reduced_atoms.hpp"

namespace shapefit {

// Below this lambda the squares of atoms of which a coefficient is not 0 underflow.
constexpr double MIN_LAMBDA = 1e-140;

// The step, and the `Terms` of the active-set method: V_i = Rbar B_i, h_i = <V_i, w>.
// An atom counts as optimal up to lam (1 + SLACK).
class CoefficientStep {
  public:
    static constexpr bool scaled = false;

    CoefficientStep(Workspace& workspace, ReducedAtoms& atoms, Index p);

    // The coefficients; the step starts from them.
    ActiveSet set;

    // Set what later steps minimise: w (2, row), lam, and whether c may be negative.
    void set_program(const double* w, double lam, bool is_signed);

    // Minimise over c at the rotation R (3, 3), from the coefficients in `set`; returns
    // the least objective.
    double minimise_at(const double* R);

    // w - Rbar sum_i c_i B_i (2, row) at the end of the step.
    const double* residual() const { return residual_; }

    // shape (3, row) = sum_i c_i B_i; returns ||c||_1.
    double mix(double* shape);

    // The functions of `Terms`, see base/active_set.hpp.

    // ||V_i||^2.
    double square(Index i) const {
        return dot_padded(projected(i), projected(i), 2 * atoms_.row);
    }
    // out_e = <V_i, V_used_e> for e < m.
    void overlaps(Index i, const Index* used, Index m, double* out) const;
    // h_i - lam sign, the linear term of atom i.
    double linear_term(Index i, double sign) const { return along_[i] - lam_ * sign; }
    // Set `next` to the unused atom with the largest correlation with the residual, and
    // its sign; false where no correlation exceeds lam.
    bool choose(const ActiveSet& used, Index& next, double& sign);

  private:
    // V_i (2, row).
    double* projected(Index i) const { return projected_ + i * 2 * atoms_.row; }
    void project(Index i);
    void find_residual();
    void correlate();

    ReducedAtoms& atoms_;
    const double* w_ = nullptr;
    const double* R_ = nullptr;
    double lam_ = 0;
    bool is_signed_ = false;
    double* projected_;  // V (k, 2 row), of those that are or were used at R
    double* along_;      // h (k,), of the same
    double* residual_;   // (2 row,)
    double* back_;       // Rbar^T residual (3 q,)
    double *correlation_, *magnitudes_;  // (padded_atoms,)
};

}  // namespace shapefit
