#include "triple_poses.hpp"

#include "../pose/rotations.hpp"

namespace shapefit {
namespace {

constexpr double FLAT = 1e-6;  // a triangle as flat as this determines no pose

// The three landmarks of each triple: the first, and the others seen from it.
struct TripleLanes {
    Lanes w[2], S[3];
    Lanes to_w[2][2], to_S[2][3];
};

void gather(const SeenLandmarks& seen, const Triple* triples, TripleLanes& lanes) {
    const double* w[2] = {seen.x, seen.y};
    for (int l = 0; l < WIDTH; ++l) {
        const long i = triples[l].index[0];
        for (int a = 0; a < 2; ++a) lanes.w[a][l] = w[a][i];
        for (int b = 0; b < 3; ++b) lanes.S[b][l] = seen.S[b][i];
        for (int other = 0; other < 2; ++other) {
            const long j = triples[l].index[1 + other];
            for (int a = 0; a < 2; ++a) lanes.to_w[other][a][l] = w[a][j] - w[a][i];
            for (int b = 0; b < 3; ++b) lanes.to_S[other][b][l] = seen.S[b][j] - seen.S[b][i];
        }
    }
}

// The plane of a triangle in the shape.
struct Plane {
    Lanes Q[9];           // an orthonormal basis, and the normal
    Lanes base, along, height;  // to_S = base Q_0 and along Q_0 + height Q_1
};

inline Plane span(const TripleLanes& triple) {
    Plane plane;
    plane.base = root(inner3(triple.to_S[0], triple.to_S[0]));
    for (int b = 0; b < 3; ++b) plane.Q[b] = triple.to_S[0][b] / plane.base;
    plane.along = inner3(plane.Q, triple.to_S[1]);
    for (int b = 0; b < 3; ++b) plane.Q[3 + b] = triple.to_S[1][b] - plane.along * plane.Q[b];
    plane.height = root(inner3(plane.Q + 3, plane.Q + 3));
    orthonormalise(plane.Q);
    return plane;
}

}  // namespace

void pose_triples(const SeenLandmarks& seen, const Triple* triples, PoseLanes poses[2]) {
    TripleLanes triple;
    gather(seen, triples, triple);
    const Plane plane = span(triple);
    Lanes G[2][2], normal[2];
    for (int a = 0; a < 2; ++a) {
        G[a][0] = triple.to_w[0][a] / plane.base;
        G[a][1] = (triple.to_w[1][a] - plane.along * G[a][0]) / plane.height;
    }
    const Lanes xx = square(G[0][0]) + square(G[0][1]), yy = square(G[1][0]) + square(G[1][1]);
    const Lanes xy = G[0][0] * G[1][0] + G[0][1] * G[1][1];
    const Lanes largest = 0.5 * (xx + yy + root(square(xx - yy) + 4.0 * square(xy)));
    const Lanes s = root(largest), zero{};
    normal[0] = root(larger(largest - xx, zero));
    normal[1] = root(larger(largest - yy, zero));
    normal[1] = xy > 0 ? -normal[1] : normal[1];
    const Lanes flat = FLAT * larger(plane.base, magnitude(plane.along));
    const Lanes size = plane.base > 0 ? (plane.height > flat ? (largest > 0 ? s : zero) : zero) : zero;
    for (int side = 0; side < 2; ++side) {
        PoseLanes& pose = poses[side];
        const double sign = 1 - 2 * side;
        pose.size = size;
        for (int a = 0; a < 2; ++a)
            for (int b = 0; b < 3; ++b)
                pose.R[3 * a + b] = (G[a][0] * plane.Q[b] + G[a][1] * plane.Q[3 + b] +
                                     sign * normal[a] * plane.Q[6 + b]) / s;
        orthonormalise(pose.R);
        for (int a = 0; a < 2; ++a) pose.T[a] = triple.w[a] - s * inner3(pose.R + 3 * a, triple.S);
    }
}

}  // namespace shapefit
