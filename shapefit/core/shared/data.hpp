// What the kernels of lifting read and write, as Python lays it out.
#pragma once

#include "../convex/data.hpp"

namespace shapefit {

// 1/2 ||w - s Rbar S||^2 - 1/2 ||w||^2 at a rotation, and s.
struct Misfit {
    double value;
    double scale;

    void give_to(Arguments& to) const { to.give_number(value), to.give_number(scale); }
};

// A step within a trust region: whether it ends at the edge, and the fall that the model promises.
struct TrustedStep {
    bool at_edge;
    double fall;

    void give_to(Arguments& to) const { to.give_flag(at_edge), to.give_number(fall); }
};

// Where an alternation ended.
struct AlternationEnd {
    long steps;
    bool converged;

    void give_to(Arguments& to) const { to.give_count(steps), to.give_flag(converged); }
};

// argmin sum_i ||M_i - c_i Rbar||_F^2 over c >= 0 and Rbar Rbar^T = I, for each image.
struct SynchronisationData {
    Arguments& from;
    GivenTransforms transforms{from};  // M
    Tensor<double> rotation = from("rotation", "n 3 3");  // R, left alone where all M_i are 0
};

// S = sum_i c_i R_i B_i and its parts, for each image.
struct ReconstructionData {
    Arguments& from;
    GivenTransforms transforms{from};  // M
    Tensor<const double> atoms = from("atoms", "k 3 p");  // B
    bool orthogonal = from("orthogonal");  // the first rows of R_i are orthonormal, too
    Vector<double> sizes = from("sizes", "a");  // c_i = ||M_i||_2 of each transform
    Tensor<double> shapes = from("shapes", "n 3 p");  // S
    Tensor<double> rotation = from("rotation", "n 3 3");  // left alone where none is known
    Vector<int64_t> active = from("active", "n");  // number of atoms that are not negligible
    Vector<bool> tight = from("tight", "n");  // whether their transforms are all orthogonal
};

// S = R sum_i c_i B_i, for each image.
struct CombinationData {
    Arguments& from;
    Matrix<const double> coefficients = from("coefficients", "n k");  // c
    Tensor<const double> atoms = from("atoms", "k 3 p");  // B
    Tensor<const double> rotation = from("rotation", "n 3 3");  // R
    Tensor<double> shapes = from("shapes", "n 3 p");  // S
};

// argmin_T 1/2 ||Omega o (W - S - T 1^T)||_F^2, for each image.
struct PlacementData {
    Arguments& from;
    Tensor<const double> landmarks = from("landmarks", "n 2 p");  // W
    Matrix<const double> weights = from("weights", "n p");  // Omega
    Tensor<const double> shapes = from("shapes", "n d p");  // S, its first two rows
    bool is_known = from("is_known");  // T is given
    Matrix<double> translation = from("translation", "n 2");  // T, nan where nothing is seen
    Vector<double> misfit = from("misfit", "n");  // the value at T
    Vector<double> residual = from("residual", "n");  // its root beside that of the centred W
};

// What a pose depends on: P = S Omega^2 S^T and D = W Omega^2 S^T about the weighted means.
struct MomentsData {
    Arguments& from;
    Tensor<const double> landmarks = from("landmarks", "n 2 p");  // W
    Matrix<const double> weights = from("weights", "n p");  // Omega
    Matrix<const double> shape = from("shape", "3 p");  // S
    Tensor<double> shape_moments = from("shape_moments", "n 3 3");  // P
    Tensor<double> landmarks_by_shape = from("landmarks_by_shape", "n 2 3");  // D
};

// Views turned about their optical axes until <D, Rbar> is largest.
struct ViewsData {
    Arguments& from;
    Tensor<const double> landmarks_by_shape = from("landmarks_by_shape", "n 2 3");  // D
    Tensor<const double> views = from("views", "v 3 3");
    Blocks<double> turned = from("turned", "n v 3 3");
};

// argmin 1/2 ||w - s Rbar S||_F^2 over rotations and s >= 0, for each image.
struct PoseData {
    Arguments& from;
    Tensor<const double> shape_moments = from("shape_moments", "n 3 3");  // P = S S^T
    Tensor<const double> landmarks_by_shape = from("landmarks_by_shape", "n 2 3");  // D = w S^T
    Blocks<const double> starts = from("starts", "n v 3 3");
    Tensor<double> rotation = from("rotation", "n 3 3");
    Vector<double> size = from("size", "n");  // s
};

// min 1/2 ||Omega o (W - Rbar sum_i c_i B_i - T 1^T)||_F^2 + lambda ||c||_1, Rbar Rbar^T = I.
struct AlternationData {
    Arguments& from;
    Tensor<const double> landmarks = from("landmarks", "n 2 p");  // W
    Matrix<const double> weights = from("weights", "n p");  // Omega
    Tensor<const double> atoms = from("atoms", "k 3 p");  // B
    Vector<const double> lam = from("lam", "n");
    Blocks<const double> starts = from("starts", "n s 3 3");
    bool is_signed = from("is_signed");  // c of either sign, or c >= 0
    // relative fall of the objective in a round at which it ends
    double tolerance = from("tolerance");
    long most_rounds = from("most_rounds");
    // of the best start; so are rotation and status
    Matrix<double> coefficients = from("coefficients", "n k");
    Tensor<double> rotation = from("rotation", "n 3 3");
    Vector<int64_t> rounds = from("rounds", "n");  // of all starts together
    Vector<int64_t> status = from("status", "n");  // a Status
};

}  // namespace shapefit
