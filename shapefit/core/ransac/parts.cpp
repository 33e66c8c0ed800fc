#include "parts.hpp"

#include "../base/registry.hpp"
namespace shapefit {
namespace {

// All p landmarks of w, of weight 1 each.
SeenLandmarks see_all(Workspace& workspace, Matrix<const double> w, Matrix<const double> S) {
    const long p = w.size[1];
    const Vector<double> ones = workspace.vector<double>(p);
    for (long j = 0; j < p; ++j) ones[j] = 1;
    SeenLandmarks seen = room_for_landmarks(workspace, p);
    see(w, {ones.data, {p}}, S, seen);
    return seen;
}

void copy(const double* from, long count, double* to) {
    for (long e = 0; e < count; ++e) to[e] = from[e];
}

}  // namespace

void draw_candidates(Vector<const int64_t> candidates, Vector<uint64_t> state,
                     Vector<int64_t> triple) {
    const Triple drawn = draw_triple(state[0], candidates.size[0]);
    for (int i = 0; i < TRIPLE; ++i) triple[i] = candidates[drawn.index[i]];
}

double pose_triple(Matrix<const double> w, Matrix<const double> S, Vector<const int64_t> triple,
                   Tensor<double> R) {
    Workspace workspace;
    const SeenLandmarks seen = see_all(workspace, w, S);
    Triple triples[WIDTH];
    for (Triple& lane : triples)
        for (int i = 0; i < TRIPLE; ++i) lane.index[i] = triple[i];
    PoseLanes poses[2];
    pose_triples(seen, triples, poses);
    for (int side = 0; side < 2; ++side)
        for (int e = 0; e < 9; ++e) R[side].data[e] = poses[side].R[e][WIDTH - 1];
    return poses[0].size[WIDTH - 1];
}

double area_of(Matrix<const double> w, Vector<const int64_t> visible) {
    Workspace workspace;
    SeenLandmarks seen = room_for_landmarks(workspace, visible.size[0]);
    seen.count = visible.size[0];
    for (long j = 0; j < seen.count; ++j) {
        seen.x[j] = w[0][visible[j]];
        seen.y[j] = w[1][visible[j]];
    }
    return find_area(seen);
}

double gain_of(Matrix<const double> w, Vector<const double> squares, Matrix<const double> S,
               double size, Matrix<const double> R, Vector<const double> T, double threshold,
               double area, bool lanes, Vector<bool> inliers) {
    Workspace workspace;
    SeenLandmarks seen = room_for_landmarks(workspace, inliers.size[0]);
    see(w, squares, S, seen);
    WeakPose pose{size, {}, {T[0], T[1]}};
    copy(R.data, 9, pose.R);
    double* inside = workspace.zeros<double>(inliers.size[0]);
    double gain = judge(seen, pose, {threshold, area}, inside);
    for (long j = 0; j < inliers.size[0]; ++j) inliers[j] = false;
    for (long j = 0; j < seen.count; ++j) inliers[seen.index[j]] = inside[j] > 0;
    if (!lanes) return gain;
    PoseLanes poses;
    Lanes gains;
    poses.size = all(size);
    for (int e = 0; e < 9; ++e) poses.R[e] = all(pose.R[e]);
    for (int a = 0; a < 2; ++a) poses.T[a] = all(T[a]);
    judge_lanes(seen, poses, {threshold, area}, gains);
    return gains[WIDTH - 1];
}

void moments_of(Matrix<const double> w, Vector<const double> squares, Matrix<const double> S,
                Vector<const bool> inliers, Matrix<double> P, Matrix<double> D,
                Vector<double> middle, Vector<double> origin) {
    Workspace workspace;
    SeenLandmarks seen = room_for_landmarks(workspace, inliers.size[0]);
    see(w, squares, S, seen);
    double* inside = workspace.zeros<double>(inliers.size[0]);
    for (long j = 0; j < seen.count; ++j) inside[j] = inliers[seen.index[j]];
    const Moments moments = find_moments(seen, inside);
    copy(moments.P, 9, P.data);
    copy(moments.D, 6, D.data);
    copy(moments.middle, 3, middle.data);
    copy(moments.origin, 2, origin.data);
}

const Exported<draw_candidates> draw_triple_exported{"draw_triple", PART};
const Exported<area_of> find_area_exported{"find_area", PART};
const Exported<moments_of> find_moments_exported{"find_moments", PART};
const Exported<gain_of> judge_exported{"judge", PART};
const Exported<pose_triple> pose_triple_exported{"pose_triple", PART};

}  // namespace shapefit
