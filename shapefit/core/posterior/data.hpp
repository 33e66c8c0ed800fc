// What the posterior over shape and view reads and writes, as Python lays it out.
#pragma once

#include "../base/registry.hpp"

namespace shapefit {

// w_j = s (P_j R x_j + t) + noise, x ~ sum_k pi_k N(mu_k, C_k), for n images and K components, with
// P_j = [I | -slope_j], along the ray on which landmark j lies.
struct PosteriorData {
    Arguments& from;
    Tensor<const double> landmarks = from("landmarks", "n 2 p");  // w
    // of the rays: x and y per depth z; 0 = weak perspective
    Tensor<const double> slopes = from("slopes", "n 2 p");
    // v, variance in the unit of shapes, inf = hidden
    Matrix<const double> misfit = from("misfit", "n p");
    // V, covariance in the unit of the landmarks
    Blocks<const double> noise = from("noise", "n p 2 2");
    Vector<const double> log_weights = from("log_weights", "K");  // log pi
    Tensor<const double> means = from("means", "K 3 p");  // mu
    Tensor<const double> covariances = from("covariances", "K 3p 3p");  // C
    Blocks<const double> starts = from("starts", "n S 3 3");  // nan where there are fewer
    double chance = from("chance");  // that a landmark is gross
    double density = from("density");  // of gross landmarks, per area in their unit
    double still = from("still");  // a climb ends when the log likelihood gains less
    Tensor<double> mean = from("mean", "n 3 p");  // of y = s (R x + t), mean depth 0
    Tensor<double> deviation = from("deviation", "n 3 p");  // its standard deviations
    // of x with y, x with z and y with z of a landmark
    Tensor<double> correlation = from("correlation", "n 3 p");
    Tensor<double> covariance = from("covariance", "n 3p 3p?");  // where it is wanted
    Matrix<double> belief = from("belief", "n p");  // that a landmark is not gross
    Tensor<double> rotation = from("rotation", "n 3 3");  // of the most likely mode
    Vector<double> scale = from("scale", "n");  // likewise
    Vector<double> log_evidence = from("log_evidence", "n");  // of the image
    // squared Mahalanobis distance of the landmarks, noise of landmark j over its belief
    Vector<double> surprise = from("surprise", "n");
    Vector<bool> stationary = from("stationary", "n");  // whether a climb ended on a maximum
    Vector<int64_t> rounds = from("rounds", "n");  // steps taken by all climbs together
    // The M most likely modes, where they are wanted.
    Matrix<int64_t> mode_component = from("mode_component", "n M?");  // -1 where there are fewer
    Blocks<double> mode_rotation = from("mode_rotation", "n M 3 3?");
    Matrix<double> mode_scale = from("mode_scale", "n M?");
    // -inf where there are fewer
    Matrix<double> mode_log_evidence = from("mode_log_evidence", "n M?");
    Blocks<double> mode_mean = from("mode_mean", "n M 3 p?");
    Blocks<double> mode_covariance = from("mode_covariance", "n M 3p 3p?");
    Tensor<double> mode_belief = from("mode_belief", "n M p?");
};

}  // namespace shapefit
