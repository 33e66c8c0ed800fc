// What the measures of estimated shapes read and write, as Python lays it out.
#pragma once

#include "../base/arguments.hpp"

namespace shapefit {

// Estimates e and true shapes x of n images. Landmarks that are not finite on one side do not count;
// with fewer than `fewest` an image has no error.
struct SimilarityData {
    Arguments& from;
    Tensor<const double> estimate = from("estimate", "n 3 p");
    Tensor<const double> truth = from("truth", "n 3 p");
    long fewest = from("fewest");
    Vector<double> error = from("error", "n");
};

struct CameraData {
    Arguments& from;
    Tensor<const double> estimate = from("estimate", "n 3 p");
    Tensor<const double> truth = from("truth", "n 3 p");
    Tensor<const double> rotation = from("rotation", "n 3 3");  // from the truth to the camera
    long fewest = from("fewest");
    Tensor<double> apart = from("apart", "n 3 p");  // s e_j + t - R x_j, 0 where j does not count
    Vector<double> scale = from("scale", "n");      // s
    Vector<double> error = from("error", "n");
};

struct SpreadData {
    Arguments& from;
    Tensor<const double> estimate = from("estimate", "n 3 p");
    Tensor<const double> truth = from("truth", "n 3 p");
    Vector<double> spread = from("spread", "n");  // nan where all points are one
};

}  // namespace shapefit
