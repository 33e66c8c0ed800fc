// One damped step of the refinement under perspective.
//
// Of the pose X <- X + omega x (R S) + tau and the coefficients c <- c + d_c:
//
//     d = argmin 1/2 |J d + r|^2 + ridge/2 |c + d_c - prior|^2
//                + damping/2 sum_i (J^T J)_ii d_i^2
//         over d_c >= -c with gauge^T d_c = 0.
//
// 1/2 |J d + r|^2 is the square that touches Cauchy's loss from above at r: each row of
// J and r has the root of 1 / (1 + |r_j|^2 / s^2) as a factor.
//
// With H = J^T J, damped, in its parts of pose (p) and coefficients (c), and L L^T =
// H_pp, C = L^-1 H_pc, g = -L^-1 J_p^T r, the pose is eliminated:
//
//     Q = H_cc + ridge I - C^T C,    h = ridge (prior - c) - J_c^T r - C^T g + Q c
//     c + d_c = argmin 1/2 x^T Q x - h^T x   over x >= 0 with gauge^T x = 1
//     L^T d_p = g - C d_c
#pragma once

#include "../base/active_set.hpp"
#include "projection.hpp"

namespace shapefit {

// omega and tau.
constexpr int POSE = 6;

// H at a position, and the damped step that follows from it.
class NormalEquations {
  public:
    NormalEquations(Workspace& workspace, const Shapes& shapes);

    // Set J, r and H = J^T J at a position, for s = softness.
    void linearise(const Observations& observations, const Position& here,
                   double softness);

    // Set `next` to where the step d leads from `at`.
    void step(double damping, const Unknowns& at, Unknowns& next);

  private:
    void find_depths_and_weights(const Observations& observations, const Position& here,
                                 double softness);
    void fill_row(const Observations& observations, const Position& here, Index j,
                  int a, double* row) const;
    void sum_squares(Index rows);
    void eliminate_pose(double damping);
    void find_matrix(double damping);
    void find_linear_term(const double* c);
    void minimise_coefficients(double* x);
    void substitute_pose(double* pose) const;

    const Shapes& shapes_;
    const Index width_;       // of a row of J: pose, r, an empty one, coefficients
    Matrix<double> J_, H_;    // (2 p, width), (width, width)
    double* root_of_weight_;  // (p,)
    double* inverse_depth_;   // (p,)
    double L_[POSE][POSE], g_[POSE];
    Matrix<double> C_;  // (6, k')
    Matrix<double> Q_;  // (k', k')
    double* h_;         // (k',)
    double* change_;    // d_c (k',)
    double *score_, *ones_;
    ActiveSet set_;
};

}  // namespace shapefit
