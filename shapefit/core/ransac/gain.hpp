// How much a weak perspective pose s, Rbar, T explains beyond its own triple:
//
//     gain = log(A / (pi tol)) (sum_j omega_j^2 max(0, 1 - r_j^2 / tol) - 3),   tol = (threshold s)^2,
//
// with residuals r_j = ||w_j - s Rbar S_j - T||, visible landmarks spread over an area A, and
// omega^2 of mean 1. The sum is the truncated one of MSAC; residuals count in units of the size of
// the shape. The logarithm is the surprise of a landmark that keeps to its place, where a wrong one
// could be anywhere in A: without it a shape blown up far beyond the image finds some landmarks in
// its wide tolerance always. Three landmarks fit whatever they are.
#pragma once

#include "triple_poses.hpp"

namespace shapefit {

struct WeakPose {
    double size;
    double R[9];
    double T[2];
};

// What residuals are measured by.
struct Tolerance {
    double threshold;
    double area;
};

// 12 sqrt(det Cov) of the visible landmarks: the area of a rectangle with their covariance.
double find_area(const SeenLandmarks& seen);

// The gain of a pose; inside (count,) becomes 1 for the landmarks in its tolerance, else 0.
// -infinity, and no landmark inside, where the tolerance covers the whole area.
double judge(const SeenLandmarks& seen, const WeakPose& pose, const Tolerance& tolerance,
             double* inside);

// The gains of a pose a lane, -infinity also where there is none.
void judge_lanes(const SeenLandmarks& seen, const PoseLanes& poses, const Tolerance& tolerance,
                 Lanes& gains);

}  // namespace shapefit
