// One mode of the posterior: a component and a view, and the shape expected there.
#pragma once

#include "likelihood.hpp"

namespace shapefit {

struct Mode {
    long component;
    Rotation R;
    double log_scale;
    double log_evidence;
    double surprise;
    bool stationary;            // nothing is left to climb, and every way leads down
    double root[VIEW * VIEW];   // W with W^T W = (H + I)^-1, the covariance of the view
    double* belief;  // (m,)
};

struct ModeSpace {
    ModeSpace(Workspace& workspace, long p);

    long p;

    // C turned into the frame of the camera; then the covariance of y (3p, 3p). Rows are padded.
    Matrix<double> C;
    Matrix<double> K;  // P C and the translation, as rows (2m, 3p)
    Matrix<double> U;  // s S^-1/2 K (2m, 3p)
    Matrix<double> J;  // derivatives of y over theta (4, 3p)
    double *S, *V;     // S and its Cholesky factor, and the inverse of that (2m, 2m)
    Vector<double> y, alpha, white, change;  // (2m,)
    Vector<double> mean, X, turned;          // (3p,), twice that
};

// Mean y (3p,) with mean depth 0; its covariance, the uncertainty of the view included, in `space.C`:
// the `whole`, or of each landmark x with y and z, and y with z.
void describe(const PosteriorData& data, const Observed<double>& seen, const Mode& mode, ModeSpace& space,
              bool whole, double* mean);

}  // namespace shapefit
