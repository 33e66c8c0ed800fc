// Weak perspective poses that three landmarks determine, of as many triples at a time as there are lanes.
//
// With an orthonormal basis Q of the plane of the triple i, j, k in the shape, its normal n and
// s Rbar = G Q^T + a n^T, the landmarks w_j - w_i, w_k - w_i give G, and rows of equal length at
// right angles mean a a^T = s^2 I - G G^T. That has rank one: s is the spectral norm of G, and a is
// known but for its sign, which reflects the depths.
// Source: Huttenlocher and Ullman, Recognizing solid objects by alignment, IJCV 1990.
#pragma once

#include "../base/lanes.hpp"
#include "draws.hpp"
#include "seen_landmarks.hpp"

namespace shapefit {

// Poses x -> s Rbar x + T, one a lane.
struct PoseLanes {
    Lanes size;  // s, 0 where the triple determines no pose
    Lanes R[9];
    Lanes T[2];
};

// Both poses of each triple.
void pose_triples(const SeenLandmarks& seen, const Triple* triples, PoseLanes poses[2]);

}  // namespace shapefit
