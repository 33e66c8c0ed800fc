// What the posterior over shape and view reads and writes, as Python lays it out.
#pragma once

#include <stdint.h>

#include "../algebra/views.hpp"

namespace shapefit {

// w_j = s (P_j R x_j + t) + noise, x ~ sum_k pi_k N(mu_k, C_k), for n images and K components, with
// P_j = [I | -slope_j], along the ray on which landmark j lies.
struct PosteriorData {
    Tensor<const double> landmarks;    // w (n, 2, p)
    Tensor<const double> slopes;       // (n, 2, p) of the rays: x and y per depth z; 0 = weak perspective
    Matrix<const double> misfit;       // v (n, p), variance in the unit of shapes, inf = hidden
    Blocks<const double> noise;        // V (n, p, 2, 2), covariance in the unit of the landmarks
    Vector<const double> log_weights;  // log pi (K,)
    Tensor<const double> means;        // mu (K, 3, p)
    Tensor<const double> covariances;  // C (K, 3p, 3p)
    Blocks<const double> starts;       // (n, S, 3, 3), nan where there are fewer
    double chance;                     // that a landmark is gross
    double density;                    // of gross landmarks, per area in their unit
    long most_rounds;
    Tensor<double> mean;          // of y = s (R x + t) (n, 3, p), mean depth 0
    Tensor<double> deviation;     // its standard deviations (n, 3, p)
    Tensor<double> correlation;   // of x with y, x with z and y with z of a landmark (n, 3, p)
    Tensor<double> covariance;    // (n, 3p, 3p), or (0, 0, 0) where it is not wanted
    Matrix<double> belief;        // (n, p) that a landmark is not gross
    Tensor<double> rotation;      // of the most likely mode (n, 3, 3)
    Vector<double> scale;         // likewise (n,)
    Vector<double> log_evidence;  // (n,) of the image
    Vector<double> surprise;      // (n,) twice the fall of the log likelihood below its peak
    Vector<int64_t> rounds;       // (n,) steps taken by all climbs together
    // The M most likely modes, (n, M, ...), or (0, 0, ...) where they are not wanted.
    Matrix<int64_t> mode_component;  // -1 where there are fewer
    Blocks<double> mode_rotation;    // (n, M, 3, 3)
    Matrix<double> mode_scale;
    Matrix<double> mode_log_evidence;  // -inf where there are fewer
    Blocks<double> mode_mean;          // (n, M, 3, p)
    Blocks<double> mode_covariance;    // (n, M, 3p, 3p)
    Tensor<double> mode_belief;        // (n, M, p)
};

}  // namespace shapefit
