// A mode of the posterior given the usual lengths of limbs, of a body of any size.
//
// A mode is y ~ N(m, C). Its limbs have the lengths l(y), and of bodies is known
// log l = k + g 1 + e with a size g that may be anything and e ~ N(0, S). Both together
// are likeliest where
//
//     (y - m)^T C^-1 (y - m) + r^T Q r,    r = log l(y) - k,
//
// is least, with Q = P - P 1 1^T P / (1^T P 1) and P = S^-1: g is integrated out. With
// the derivative J of r at y, Gauss-Newton steps go to
//
//     y <- m - C J^T G (r + J (m - y)),    G = (I + Q J C J^T)^-1 Q.
//
// The covariance there is C - C J^T G J C. The log evidence of the mode falls by half
// of the least value and half of log det (I + Q J C J^T).
//
// A limb joins two landmarks i and j, and its row of J holds u at i and -u at j, for
// u = (y_i - y_j) / ||y_i - y_j||^2.
#pragma once

#include "likelihood.hpp"

namespace shapefit {

// The usual lengths of limbs, by which modes are conditioned.
class LimbLengths {
  public:
    LimbLengths(Workspace& workspace, const PosteriorData& data);

    // Whether the usual length of any limb is known.
    bool are_known() const { return count_ > 0; }

    // Condition a mode on the lengths: its mean y (3 p,) and its covariance C (3 p, 3
    // p), all x first, then y, then z, are overwritten, C below its diagonal and on it.
    // Returns by how much the log evidence falls.
    double condition(double* y, double* C);

  private:
    // Set r, u, J C, J C J^T, G and G (r + J (m - y)) at y; returns log det (I + Q J C
    // J^T).
    double linearise(const double* y, const double* C);

    const Index p_, d_, count_;
    Matrix<const int64_t> limbs_;
    Vector<const double> log_length_;
    Matrix<const double> Q_;
    double *m_, *excess_, *u_, *JC_, *JCJ_, *system_, *G_, *force_, *GJC_;
};

}  // namespace shapefit
