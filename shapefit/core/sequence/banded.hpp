// Cholesky factor of the Hessian of a sequence: each frame is tied to the two after it.
//
// A = U^T U with the blocks U_ff, N_f = U_f,f+1 and W_f = U_f,f+2 of frame f, and V_f =
// U_ff^-T:
//
//   U_ff^T U_ff = A_ff - N_(f-1)^T N_(f-1) - W_(f-2)^T W_(f-2)
//   N_f = V_f (A_f,f+1 - N_(f-1)^T W_(f-1)),     W_f = V_f A_f,f+2
//
// Frames are tied by the motion alone, coordinate by coordinate, so that A_f,f+1 and
// A_f,f+2 are diagonal and W_f is lower triangular. V and N are kept, W_f is V_f with
// its columns scaled.
#pragma once

#include "marginal.hpp"

namespace shapefit {

class Banded {
  public:
    Banded(Workspace& workspace, const SequenceData& data)
        : t_(data.points.size[0]),
          D_(padded(data.points.size[1])),
          E_(padded(1 + data.lengths.size[0])),
          V_(workspace.zeros<double>(t_ * D_ * D_)),
          N_(workspace.zeros<double>(t_ * D_ * D_)),
          F_(workspace.zeros<double>(t_ * D_ * E_)),
          W_(workspace.zeros<double>(3 * D_ * D_)),
          S_(workspace.zeros<double>(D_ * D_)),
          R_(workspace.zeros<double>(D_ * E_)),
          products_(workspace.zeros<double>(E_ * E_)),
          covariances_(workspace.zeros<double>(8 * D_ * D_)),
          turned_(workspace.zeros<double>(D_ * D_)),
          tied_(workspace.zeros<double>(D_)),
          left_(workspace.zeros<double>(D_)) {}

    // Factor the Hessian of the frames at a place, `damping` added to its diagonal, and
    // take the right sides R of `derive` along; false where it is not positive
    // definite.
    bool factorise(const SequenceData& data, const Place& at, Bones bones,
                   double damping);

    // Sums of products of the right sides, R^T A^-1 R (E, E).
    const double* products() const { return products_; }
    Index columns() const { return E_; }

    // out (t, D) = A^-1 (R_0 + sum_b R_(1 + b) x_b)
    void solve(const SequenceData& data, const double* x, Matrix<double> out) const;

    // The covariance of each frame's points, the lengths held, to `data`: its block of
    // A^-1, with the mixture of the frame in the place of what stands for it in A; and
    // the energies of the frames.
    void write_covariances(const SequenceData& data, const Place& at,
                           Marginal& marginal) const;

  private:
    // The room that the covariances of three frames take, and G_N, G_W (D, D) each.
    struct Covariances {
        Covariances(double* room, Index D);

        double *here, *next, *last;  // Sigma of f with itself, of f + 1, of f + 2
        double *one, *two;           // of f with f + 1, with f + 2
        double* between;             // of f + 1 with f + 2
        double *GN, *GW;
    };

    // The diagonal of A_f,f+lag, without damping (D,); of W_f = V_f diag(tied) for 2.
    void find_tied(const SequenceData& data, Index f, Index lag, double* tied) const;

    void begin_frame(const SequenceData& data, const Place& at, Index f, Bones bones,
                     double damping);
    void subtract_earlier_frames(Index f);
    void finish_right_side(Index f);
    void tie_to_next(const SequenceData& data, Index f);
    void tie_to_second(const SequenceData& data, Index f);

    void find_gains(const SequenceData& data, Index f, Covariances& Sigma) const;
    void find_covariances(Covariances& Sigma) const;

    double* V(Index f) const { return V_ + f * D_ * D_; }
    double* N(Index f) const { return N_ + f * D_ * D_; }
    double* W(Index f) const { return W_ + f % 3 * D_ * D_; }  // lives for two frames
    double* F(Index f) const { return F_ + f * D_ * E_; }

    Index t_, D_, E_;
    double *V_, *N_;        // (t, D, D)
    double* F_;             // U_ff^-T of the right sides, less those before, (t, D, E)
    double* W_;             // (3, D, D)
    double *S_, *R_;        // Hessian and right sides of the frame at work
    double* products_;      // (E, E)
    double* covariances_;   // room for Covariances
    double* turned_;        // (D, D)
    double *tied_, *left_;  // (D,)
};

}  // namespace shapefit
