// What the inference over sequences reads and writes, as Python lays it out.
#pragma once

#include "../base/registry.hpp"

namespace shapefit {

// Precisions (factor C + more I)^-1 in the place of covariances C, and log det, where `there` is set.
struct PrecisionData {
    Arguments& from;
    Blocks<double> matrices = from("matrices", "n K d d");
    Matrix<const double> factor = from("factor", "n K");  // 0 where C is not known
    Matrix<const double> more = from("more", "n K");
    Matrix<const bool> there = from("there", "n K");
    Matrix<double> log_det = from("log_det", "n K");
};

// One sequence of t frames y_t (3p,) and its bones, of lengths l (e,); see smoothing.hpp.
struct SequenceData {
    Arguments& from;
    Matrix<const double> landmarks = from("landmarks", "t 2p");  // w, any number where hidden
    Matrix<const double> weight = from("weight", "t 2p");  // of their squares, 0 where hidden
    // of the modes, -inf where there are fewer
    Matrix<const double> log_share = from("log_share", "t K");
    Tensor<const double> means = from("means", "t K 3p");  // m
    Blocks<const double> precisions = from("precisions", "t K 3p 3p");  // P
    Matrix<const double> log_det = from("log_det", "t K");  // of the covariances
    Vector<const double> stiffness = from("stiffness", "p");  // 1/a^2
    Matrix<const int64_t> bones = from("bones", "e 2");
    Vector<const double> rigidity = from("rigidity", "e");  // 1/b^2
    Matrix<const double> hold = from("hold", "e e");  // H of (l - known)^T H (l - known)
    Vector<const double> known = from("known", "e");
    long most_rounds = from("most_rounds");
    double still = from("still");  // rounds end when the energy per frame falls by less
    Matrix<double> points = from("points", "t 3p");  // y: the start, and then the minimum
    Vector<double> lengths = from("lengths", "e");  // l, likewise
    Matrix<double> deviation = from("deviation", "t 3p?");  // of the points, where it is wanted
    // likewise, of x with y, x with z and y with z of a landmark
    Matrix<double> correlation = from("correlation", "t 3p?");
    Tensor<double> covariance = from("covariance", "t 3p 3p?");  // of each frame, likewise
    // energy at the minimum, log det of the Hessian of the frames there, rounds
    Vector<double> end = from("end", "3");
};

}  // namespace shapefit
