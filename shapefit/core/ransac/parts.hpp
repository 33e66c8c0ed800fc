// The steps of the search for outliers on plain arrays, for the tests.
#pragma once

#include "consensus.hpp"

namespace shapefit {

// Three different candidates (m,) into triple (3,); state (1,) of the generator moves on.
void draw_candidates(Vector<const int64_t> candidates, Vector<uint64_t> state,
                     Vector<int64_t> triple);

// s and both R (2, 3, 3) of landmarks w (2, p) and shape S (3, p) on a triple.
double pose_triple(Matrix<const double> w, Matrix<const double> S, Vector<const int64_t> triple,
                   Tensor<double> R);

double area_of(Matrix<const double> w, Vector<const int64_t> visible);

// The gain of a pose, and its inliers (p,); with `lanes` the gain as the search has it.
double gain_of(Matrix<const double> w, Vector<const double> squares, Matrix<const double> S,
               double size, Matrix<const double> R, Vector<const double> T, double threshold,
               double area, bool lanes, Vector<bool> inliers);

void moments_of(Matrix<const double> w, Vector<const double> squares, Matrix<const double> S,
                Vector<const bool> inliers, Matrix<double> P, Matrix<double> D,
                Vector<double> middle, Vector<double> origin);

}  // namespace shapefit
