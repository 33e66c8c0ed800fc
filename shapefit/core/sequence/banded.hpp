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

// The factor of A, in memory for all frames, and what is solved with it.
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

    // Factorise the Hessian of the frames at a place, `damping` added to its diagonal,
    // and the right sides R of `derive` with it; false where it is not positive
    // definite.
    bool factorise(const SequenceData& data, const Place& at, Bones bones,
                   double damping);

    // R^T A^-1 R (E, E) of the right sides.
    const double* products() const { return products_; }
    // E, the number of right sides, padded.
    Index columns() const { return E_; }

    // out (t, D) = A^-1 (R_0 + sum_b R_(1 + b) x_b).
    void solve(const SequenceData& data, const double* x, Matrix<double> out) const;

    // Write the covariance of each frame's points to `data`, for fixed lengths: by
    // `marginal`, from the frame's block of A^-1; and the energies of the frames.
    void write_covariances(const SequenceData& data, const Place& at,
                           Marginal& marginal) const;

  private:
    // The covariances of three frames, and G_N, G_W, (D, D) each, in `memory`.
    struct Covariances {
        Covariances(double* memory, Index D);

        double *here, *next, *last;  // Sigma of f with itself, of f + 1, of f + 2
        double *one, *two;           // of f with f + 1, with f + 2
        double* between;             // of f + 1 with f + 2
        double *GN, *GW;
    };

    // tied (D,) = the diagonal of the term of the motion in A_f,f+lag; for a lag of 2
    // W_f = V_f diag(tied).
    void find_motion_diagonal(const SequenceData& data, Index f, Index lag,
                              double* tied) const;

    void begin_frame(const SequenceData& data, const Place& at, Index f, Bones bones,
                     double damping);
    void subtract_earlier_frames(Index f);
    void finish_right_side(Index f);
    void find_next_block(const SequenceData& data, Index f);
    void find_second_block(const SequenceData& data, Index f);

    void find_gains(const SequenceData& data, Index f, Covariances& Sigma) const;
    void find_covariances(Covariances& Sigma) const;

    // The blocks of frame f.
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
    double* covariances_;   // memory for Covariances
    double* turned_;        // (D, D)
    double *tied_, *left_;  // (D,)
};

}  // namespace shapefit
