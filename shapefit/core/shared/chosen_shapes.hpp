// The shapes that a pursuit has chosen, orthonormal in their limb vectors.
//
// The chosen shapes are mixed into Q_i whose limb vectors U_i are orthonormal (those of the mean
// first), so that the sum of squared limb lengths of sum_i y_i Q_i is ||y||^2. All that the inner
// loop needs of the reduced landmarks w (2, q) and the Q_i (3, q) are the small products
// N_ij = Q_i Q_j^T and Z_i = w Q_i^T.
#pragma once

#include "../base/workspace.hpp"

namespace shapefit {

// One image without its translation, and all shapes as it sees them.
struct ReducedImage {
    Matrix<const double> w;       // (2, q)
    Tensor<const double> shapes;  // (1 + k, 3, q), the mean first
    Matrix<const double> limbs;   // (1 + k, l)
};

// Room for `most` chosen shapes, `count` of which are taken.
struct ChosenShapes {
    long most, count;
    Tensor<double> Q;  // (most, 3, q)
    Matrix<double> U;  // (most, l)
    Matrix<double> T;  // (most, 1 + k): Q_i = sum_j T_ij shapes_j
    Blocks<double> N;  // (most, most, 3, 3)
    Tensor<double> Z;  // (most, 2, 3)
    bool* free;        // (1 + k): the shapes that may still join
};

ChosenShapes room_for_shapes(Workspace& workspace, long most, long shapes, long q, long limbs);

// Append shape `added`, which is free no longer; false, and nothing is appended, where its limb
// vectors depend on those of the chosen ones.
bool choose_shape(long added, const ReducedImage& image, ChosenShapes& chosen);

}  // namespace shapefit
