#include "consensus.hpp"

#include "../base/registry.hpp"
#include "../base/vectors.hpp"
#include "../shared/rotation_step.hpp"

namespace shapefit {
namespace {

// Triples of inliers to be expected among the draws, after which none is drawn any more. One would do
// for exact landmarks of the very shape; on made cars, whose shapes are not the mean and whose
// landmarks are noisy, 20 find the pose in as many images as 500 draws (to three digits, for 0 to 70%
// wrong landmarks) and 5 lose it in one of a hundred with 60% wrong.
constexpr double ENOUGH = 20;
constexpr long CHECKED = 8;  // draws from one check to the next, a multiple of every WIDTH

// The landmarks inside the tolerance of a pose, now and before; 1 or 0 for each.
struct Inside {
    double *now, *before;
};

long count_differences(const double* a, const double* b, long n) {
    double total = 0;
    for (long j = 0; j < n; ++j) total += magnitude(a[j] - b[j]);
    return static_cast<long>(total);
}

double sum(const double* x, long n) {
    double total = 0;
    for (long j = 0; j < n; ++j) total += x[j];
    return total;
}

// What the search in an image has found so far.
struct Best {
    double drawn = -INFINITE;  // gain of the best pose as drawn,
    double gain = -INFINITE;   // and of the best of all, drawn or fitted to inliers,
    long inliers = 0;          // with so many
};

// Keep what lies inside the tolerance of a pose if it gains more than all before it.
void keep_better(const SeenLandmarks& seen, double gain, const double* inside, Best& best,
                 Vector<bool> inliers) {
    if (!(gain > best.gain)) return;
    best.gain = gain;
    best.inliers = static_cast<long>(sum(inside, seen.count));
    for (long j = 0; j < seen.count; ++j) inliers[seen.index[j]] = inside[j] > 0;
}

// Fit a drawn pose to its inliers and judge again, until they stay or `most` times; a fit that gains
// less than the pose before it does not replace it. A pose with no inliers but its triple is not fitted.
void settle(const SeenLandmarks& seen, const Tolerance& tolerance, long most, WeakPose& pose,
            Inside& inside, Best& best, Vector<bool> inliers) {
    keep_better(seen, judge(seen, pose, tolerance, inside.now), inside.now, best, inliers);
    for (long round = 0; round < most && sum(inside.now, seen.count) > TRIPLE; ++round) {
        const Moments moments = find_moments(seen, inside.now);
        const double size = rotation_step({moments.P, moments.D, true}, pose.R).scale;
        if (!(size > 0)) break;
        pose.size = size;
        for (int a = 0; a < 2; ++a) {
            const double* R = pose.R + 3 * a;
            pose.T[a] = moments.origin[a];
            for (int b = 0; b < 3; ++b) pose.T[a] -= size * R[b] * moments.middle[b];
        }
        double* before = inside.now;
        inside.now = inside.before;
        inside.before = before;
        keep_better(seen, judge(seen, pose, tolerance, inside.now), inside.now, best, inliers);
        if (!count_differences(inside.now, before, seen.count)) break;
    }
}

// The share of the triples of m landmarks that are triples of `inliers` of them.
double share_of_triples(long inliers, long m) {
    double share = 1;
    for (long drawn = 0; drawn < TRIPLE; ++drawn)
        share *= static_cast<double>(inliers - drawn) / static_cast<double>(m - drawn);
    return larger(share, 0);
}

WeakPose pose_of_lane(const PoseLanes& poses, int lane) {
    WeakPose pose;
    pose.size = poses.size[lane];
    for (int e = 0; e < 9; ++e) pose.R[e] = poses.R[e][lane];
    for (int a = 0; a < 2; ++a) pose.T[a] = poses.T[a][lane];
    return pose;
}

// Let both poses of `count` triples compete, in the order of the draws.
void compete(const SeenLandmarks& seen, const Triple* triples, int count, long most,
             const Tolerance& tolerance, Best& best, Inside& inside, Vector<bool> inliers) {
    PoseLanes poses[2];
    Lanes gains[2];
    pose_triples(seen, triples, poses);
    for (int side = 0; side < 2; ++side) judge_lanes(seen, poses[side], tolerance, gains[side]);
    for (int lane = 0; lane < count; ++lane)
        for (int side = 0; side < 2; ++side) {
            if (!(gains[side][lane] > best.drawn)) continue;
            best.drawn = gains[side][lane];
            WeakPose pose = pose_of_lane(poses[side], lane);
            settle(seen, tolerance, most, pose, inside, best, inliers);
        }
}

void search_image(const SeenLandmarks& seen, const ConsensusData& data, uint64_t state,
                  Inside& inside, Vector<bool> inliers) {
    const Tolerance tolerance{data.threshold, find_area(seen)};
    Best best;
    Triple triples[WIDTH] = {};
    for (long drawn = 0; drawn < data.draws; drawn += WIDTH) {
        // Stop by the inlier ratio: triples of inliers have been drawn often enough.
        const double good = drawn % CHECKED ? 0 : share_of_triples(best.inliers, seen.count);
        if (static_cast<double>(drawn) * good >= ENOUGH) break;
        const int count = static_cast<int>(data.draws - drawn < WIDTH ? data.draws - drawn : WIDTH);
        for (int lane = 0; lane < count; ++lane) triples[lane] = draw_triple(state, seen.count);
        compete(seen, triples, count, data.most_rounds, tolerance, best, inside, inliers);
    }
}

}  // namespace

void find_consensus(const ConsensusData& data, Range range) {
    const long p = data.squares.size[1];
    Workspace workspace;
    SeenLandmarks seen = room_for_landmarks(workspace, p);
    Inside inside{workspace.zeros<double>(p), workspace.zeros<double>(p)};
    for (long image = range.first; image < range.last; ++image) {
        const Vector<bool> inliers = data.inliers[image];
        for (long j = 0; j < p; ++j) inliers[j] = false;
        see(data.landmarks[image], data.squares[image], data.shape, seen);
        if (seen.count >= TRIPLE) search_image(seen, data, data.seeds[image], inside, inliers);
    }
}

Moments find_moments(const SeenLandmarks& seen, const double* inside) {
    Moments moments{};
    const double* w[2] = {seen.x, seen.y};
    double total = 0;
    for (long j = 0; j < seen.count; ++j) {
        const double share = seen.h[j] * inside[j];
        total += share;
        for (int b = 0; b < 3; ++b) moments.middle[b] += share * seen.S[b][j];
        for (int a = 0; a < 2; ++a) moments.origin[a] += share * w[a][j];
    }
    for (double& x : moments.middle) x /= total;
    for (double& x : moments.origin) x /= total;
    for (long j = 0; j < seen.count; ++j) {
        const double share = seen.h[j] * inside[j];
        double S[3];
        for (int b = 0; b < 3; ++b) S[b] = seen.S[b][j] - moments.middle[b];
        for (int b = 0; b < 3; ++b) {
            for (int a = 0; a < 3; ++a) moments.P[3 * a + b] += share * S[a] * S[b];
            for (int a = 0; a < 2; ++a)
                moments.D[3 * a + b] += share * S[b] * (w[a][j] - moments.origin[a]);
        }
    }
    return moments;
}

const Exported<find_consensus> find_consensus_exported{"find_consensus"};

}  // namespace shapefit
