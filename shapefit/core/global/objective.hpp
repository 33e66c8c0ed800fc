// v(R) = min_{c, T} 1/2 ||Omega o (W - Rbar sum_i c_i B_i - T 1^T)||_F^2 + lambda ||c||_1, at one
// rotation of one image after another.
#pragma once

#include "../atoms/coefficient_step.hpp"
#include "data.hpp"

namespace shapefit {

// What rounding may add to an objective or take off D(s Y), beside ||w||^2.
constexpr double ROUNDING = 64 * 0x1p-52;

class RotationObjective {
  public:
    RotationObjective(Workspace& workspace, const SearchProblem& problem);

    // Turn to an image; false where it shows fewer than two landmarks.
    bool aim(long image);

    // v at R (3, 3), with `coefficients()` as the start and the end of their minimisation.
    double value(const double* R);

    // Of the last value, by the turn of the camera frame: the gradient (3,), and the curvature
    // (3, 3) with the coefficients held and the residual left out (Gauss and Newton).
    void derivatives(double* gradient, double* curvature);

    ActiveSet& coefficients() { return step_.set; }
    const double* residual() const { return step_.residual(); }  // Y (2, row), 0 from q on

    // c (k,) of the last value.
    void write_coefficients(Vector<double> c) const;

    const SearchProblem& problem;
    ReducedAtoms atoms;
    Reduction reduction;
    double* w;           // (2, row)
    double lam = 0;
    double square = 0;   // ||w||^2
    double largest = 0;  // max_i ||B_i||_F

  private:
    CoefficientStep step_;
    double* shape_;  // sum_i c_i B_i (3, row)
    double R_[9];
    long image_ = -1;
};

// The coefficients at given rotations, for the images of the range.
void find_coefficients(const CoefficientsData& data, Range range);

}  // namespace shapefit
