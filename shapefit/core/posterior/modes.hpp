// One mode of the posterior: a component and a view, and the shape expected there.
#pragma once

#include "likelihood.hpp"

namespace shapefit::SHAPEFIT_LEVEL {

struct Mode {
    long component;
    double R[9];
    double log_scale;
    double log_evidence;
    double surprise;
    double hessian[VIEW * VIEW];
    double* belief;  // (m,)
};

struct ModeSpace {
    ModeSpace(Workspace& workspace, long p);

    Matrix<double> C;  // C turned into the frame of the camera (3p, 3p)
    Matrix<double> U;  // K with the translation, white (2m, 3p)
    Matrix<double> K;  // what is seen of its columns, C P^T as rows (2m, 3p)
    Matrix<double> L;  // Cholesky factor of S (2m, 2m)
    Vector<double> alpha, mean, X, pull, turned;
    Matrix<double> J;  // derivatives of y over theta (4, 3p)
};

// Mean y (3p,) with mean depth 0, and its covariance (3p, 3p), the uncertainty of the view included.
void describe(const PosteriorData& data, const Observed& seen, const Mode& mode, ModeSpace& space,
              double* mean, double* covariance);

}  // namespace shapefit::SHAPEFIT_LEVEL
