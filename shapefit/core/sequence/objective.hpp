// The objective of a sequence, and its derivatives frame by frame.
//
//     sum_f -log sum_k share_fk N(y_f; m_fk, P_fk^-1)
//     + 1/2 sum_(f,j) weight_fj ||w_fj - y_fj||^2
//     + 1/2 sum_(f,j) ||c_f0 y_fj + c_f1 y_(f+1)j + c_f2 y_(f+2)j||^2 / a_j^2
//     + 1/2 sum_(f, bones ij) (||y_fi - y_fj|| - l_ij)^2 / b_ij^2
//     + 1/2 (l - k)^T H (l - k)
//
// over frames and lengths l together.
#pragma once

#include "../base/registry.hpp"
#include "../base/vectors.hpp"

namespace shapefit {

// One sequence of t frames y_t (3p,) and its bones, of lengths l (e,).
struct SequenceData {
    Arguments& from;
    // w, any number where hidden
    Matrix<const double> landmarks = from("landmarks", "t 2p");
    // of their squares, 0 where hidden
    Matrix<const double> weight = from("weight", "t 2p");
    // of the modes, -inf where there are fewer
    Matrix<const double> log_share = from("log_share", "t K");
    Tensor<const double> means = from("means", "t K 3p");  // m
    // P g^-2
    Blocks<const double> precisions = from("precisions", "t K 3p 3p");
    // g, the unit of each frame in that of its precisions
    Vector<const double> growth = from("growth", "t");
    Matrix<const double> log_det = from("log_det", "t K");    // of the covariances
    Vector<const double> stiffness = from("stiffness", "p");  // 1/a^2
    // c of the second difference that begins at each frame, 0 where there is none
    Matrix<const double> differences = from("differences", "t 3");
    Matrix<const int64_t> bones = from("bones", "e 2");
    Vector<const double> rigidity = from("rigidity", "e");  // 1/b^2
    // H, and the usual lengths k
    Matrix<const double> length_precision = from("length_precision", "e e");
    Vector<const double> usual_lengths = from("usual_lengths", "e");
    Index max_rounds = from("max_rounds");
    // rounds end when the energy per frame falls by less
    double tolerance = from("tolerance");
    // y: the start, and then the minimum
    Matrix<double> points = from("points", "t 3p");
    Vector<double> lengths = from("lengths", "e");         // l, likewise
    Matrix<double> deviation = from("deviation", "t 3p");  // of the points
    // of x with y, x with z and y with z of a landmark
    Matrix<double> correlation = from("correlation", "t 3p");
    // of each frame, where wanted
    Tensor<double> covariance = from("covariance", "t 3p 3p?");
    // of each frame, with the second difference that begins there
    Vector<double> energies = from("energies", "t");
    Vector<double> end = from("end", "2");  // energy at the minimum, rounds
};

// A point of the minimisation, and the objective there; rows of frames are padded to D,
// a multiple of PADDING.
struct Place {
    Place(Workspace& workspace, const SequenceData& data)
        : y(workspace.matrix<double>(data.points.size[0], padded(data.points.size[1]))),
          lengths(workspace.vector<double>(data.lengths.size[0])),
          linear_term(workspace.matrix<double>(data.points.size[0],
                                               padded(data.points.size[1]))),
          share(workspace.matrix<double>(data.points.size[0], data.log_share.size[1])),
          too_long(workspace.vector<double>(data.lengths.size[0])),
          energies(workspace.vector<double>(data.points.size[0])) {}

    Matrix<double> y;            // (t, D)
    Vector<double> lengths;      // (e,)
    Matrix<double> linear_term;  // gradient of the energy of the mixtures (t, D)
    Matrix<double> share;        // of the modes at y (t, K)
    Vector<double>
        too_long;  // sum over the frames of how much longer than l a bone is (e,)
    Vector<double> energies;  // of the frames (t,)
    double energy = 0;
};

// Evaluate the objective at y and l of `at`, and store its energies, the gradient of
// the mixtures, the shares of the modes and the excess lengths there. `scratch` (1 + K,
// D).
void evaluate(const SequenceData& data, Place& at, double* scratch);

// The Hessian of the term of the bones: Gauss and Newton's, with their directions
// fixed, which is never negative, or the whole of it.
enum class Bones { HELD, WHOLE };

// Set the upper triangle of S (D, D) to the block of frame f in the Hessian without the
// term of the motion, the shares of the modes fixed, with ones on the diagonal of the
// padding; and the columns of R (D, E) to the gradient over the frame, and to its
// derivatives by the lengths.
void derive(const SequenceData& data, const Place& at, Index f, Bones bones, double* S,
            double* R, Index E);

// Add sign sum_k share_k P_k of frame f, the curvature of its mixture at y, to the
// upper triangle of S (D, D).
void add_precision(const SequenceData& data, const Place& at, Index f, double sign,
                   double* S);

// Element b of H (l - k), the gradient of the term of the usual lengths.
double length_gradient(const SequenceData& data, const Place& at, Index b);

// out = P x of a symmetric P (d, d), read above the diagonal; returns <x, P x>.
double multiply_symmetric(const double* P, const double* x, Index d,
                          double* __restrict out);

// Entry (f, f + lag) of D^T D, for D the matrix of the second differences over the
// frames.
double difference_product(const SequenceData& data, Index f, Index lag);

}  // namespace shapefit
