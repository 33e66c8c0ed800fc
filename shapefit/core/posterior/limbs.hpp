// Modes of the posterior given the usual lengths of limbs, of a body of any size, one
// mode a lane.
//
// A mode is y ~ N(m, C). Its limbs have the lengths l(y), and of bodies is known
// log l = k + g 1 + e with a size g that may be anything and e ~ N(0, S). Both together
// are likeliest where
//
//     (y - m)^T C^-1 (y - m) + r^T Q r,    r = log l(y) - k,
//
// is least, with Q = P - P 1 1^T P / (1^T P 1) and P = S^-1: g is integrated out. With
// A A^T = Q and the derivative J of r at y, Gauss-Newton steps go to
//
//     y <- m - K^T L^-T v,     K = A^T J C,    L L^T = I + A^T J C J^T A,
//                              v = L^-1 A^T (r + J (m - y)).
//
// The covariance there is C - W^T W with W = L^-1 K. The log evidence of the mode falls
// by half of the least value, |v|^2 - |L^-T v|^2 + |A^T r|^2, and half of log det L
// L^T.
//
// A limb joins two landmarks i and j, and its row of J holds u at i and -u at j, for
// u = (y_i - y_j) / ||y_i - y_j||^2.
#pragma once

#include "description.hpp"

namespace shapefit {

// The usual lengths of limbs, by which modes are conditioned.
class LimbLengths {
  public:
    LimbLengths(Workspace& workspace, const PosteriorData& data);

    // Whether the usual length of any limb is known.
    bool are_known() const { return count_ > 0; }

    // Condition modes on the lengths: their means and whole covariances are
    // overwritten. Returns by how much their log evidence falls.
    Doubles condition(Description& modes);

  private:
    // Set r, K, L^-1, v and L^-T v at the means y; returns log det L L^T.
    Doubles linearise(const Description& modes);
    // Set u of limb a, and return the logarithm of its length, at the means y.
    Doubles measure(const Doubles* y, Index a);
    // <J_a, x> for limb a and a vector x over all coordinates, whose entry e is at
    // x[e * stride].
    Doubles along(Index a, const Doubles* x, Index stride) const;

    const Index count_, n_;  // limbs, and padded
    Matrix<const int64_t> limbs_;
    Vector<const double> log_length_;  // k
    double* root_;                     // A^T (count, count)
    Doubles* m_;                       // (3 p,)
    Doubles* u_;                       // (count, 3)
    Doubles *r_, *ahead_;              // r, and A^T (r + J (m - y)) (n,)
    Doubles* row_;                     // of J C, or of K J^T
    Doubles* K_;                       // K^T (3 p, n)
    Triangle<Doubles> L_;              // I + A^T J C J^T A, L, then L^-1
    Doubles* reciprocal_;              // 1 / L_aa (n,)
    Doubles *v_, *t_;                  // v, and L^-T v (n,)
    Doubles* W_;                       // W^T (3 p, n)
};

}  // namespace shapefit
