#include "consensus.hpp"

#include "../algebra/vectors.hpp"
#include "../lifting/rotation_step.hpp"

namespace shapefit::SHAPEFIT_LEVEL {
namespace {

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

// Fit the pose to its inliers and judge again, until they stay or `most` times; the gain at the end.
// A pose with no inliers but its triple is left as it is.
double settle(const SeenLandmarks& seen, const Tolerance& tolerance, long most, double gain,
              WeakPose& pose, Inside& inside) {
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
        gain = judge(seen, pose, tolerance, inside.now);
        if (!count_differences(inside.now, before, seen.count)) break;
    }
    return gain;
}

WeakPose pose_of_lane(const PoseLanes& poses, int lane) {
    WeakPose pose;
    pose.size = poses.size[lane];
    for (int e = 0; e < 9; ++e) pose.R[e] = poses.R[e][lane];
    for (int a = 0; a < 2; ++a) pose.T[a] = poses.T[a][lane];
    return pose;
}

// What the search in an image has found so far.
struct Best {
    double drawn = -INFINITE;    // gain of the best pose as drawn,
    double settled = -INFINITE;  // and of the best after its fits to inliers
};

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
            double gain = judge(seen, pose, tolerance, inside.now);
            gain = settle(seen, tolerance, most, gain, pose, inside);
            if (!(gain > best.settled)) continue;
            best.settled = gain;
            for (long j = 0; j < seen.count; ++j) inliers[seen.index[j]] = inside.now[j] > 0;
        }
}

void search_image(const SeenLandmarks& seen, const ConsensusData& data, uint64_t state,
                  Inside& inside, Vector<bool> inliers) {
    const Tolerance tolerance{data.threshold, find_area(seen)};
    Best best;
    Triple triples[WIDTH] = {};
    for (long drawn = 0; drawn < data.draws; drawn += WIDTH) {
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

}  // namespace shapefit::SHAPEFIT_LEVEL
