// Alternation of the model with one rotation shared by all atoms, from one start or several.
#pragma once

#include "../atoms/coefficient_step.hpp"
#include "data.hpp"

namespace shapefit {

// Alternate on the images of the range, keeping the best of the starts of each image.
void alternate(const AlternationData& data, Range range);

// Room for the alternation on one image after another.
struct AlternationRoom {
    AlternationRoom(Workspace& workspace, Tensor<const double> all, long most_rounds);

    ReducedAtoms atoms;
    CoefficientStep coefficients;
    double* w;      // (2, row)
    double* shape;  // (3, row)
    double* trace;  // (2 most_rounds,) the objective after each step
};

// Alternate from R (3, 3) until a round lowers the objective by a share <= tolerance.
//
// A round is a step of the coefficients, which starts from 0, and one of the rotation. R, the
// coefficients and the trace of the room are written; its w and atoms are those of the image.
AlternationEnd alternate_image(AlternationRoom& room, double lam, bool is_signed, double tolerance,
                      long most_rounds, double* R);

// Single steps on reduced landmarks w (2, q) and atoms (k, 3, q), in room of their own.
double solve_lasso(Matrix<const double> w, Tensor<const double> atoms, Matrix<const double> R,
                   double lam, bool is_signed, Vector<double> c);
AlternationEnd alternate_once(Matrix<const double> w, Tensor<const double> atoms, double lam, bool is_signed,
                     double tolerance, Matrix<double> R, Vector<double> c, Vector<double> trace);

}  // namespace shapefit
