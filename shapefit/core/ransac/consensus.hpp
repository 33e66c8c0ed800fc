// RANSAC: poses of one shape on random triples of landmarks, and the one of the largest gain.
#pragma once

#include "data.hpp"
#include "gain.hpp"

namespace shapefit {

// The inliers of the pose of S of the largest gain. Each draw that gains more than all draws before
// is fitted to its inliers, and these are judged again; the better of the drawn and the fitted poses
// counts. An image has at most `draws` draws: they stop early by the share of inliers found. One in
// which no triple determines a pose has no inliers.
void find_consensus(const ConsensusData& data, Range range);

// S Omega^2 S^T and w Omega^2 S^T of the inliers about their weighted means, and the means.
struct Moments {
    double P[9];
    double D[6];
    double middle[3];  // of the shape
    double origin[2];  // of the landmarks
};

// inside (count,) is 1 for inliers, else 0.
Moments find_moments(const SeenLandmarks& seen, const double* inside);

}  // namespace shapefit
