// RANSAC: the pose of a known shape that most landmarks agree on, from triples of them.
//
// Weak perspective poses that three landmarks determine: with an orthonormal basis Q of
// the plane of the triple i, j, k in the shape, its normal n and s Rbar = G Q^T + a
// n^T, the landmarks w_j - w_i, w_k - w_i give G, and rows of equal length at right
// angles mean a a^T = s^2 I - G G^T. That has rank one: s is the spectral norm of G,
// and a is known but for its sign, which reflects the depths (Huttenlocher and Ullman,
// Recognizing solid objects by alignment, IJCV 1990).
//
// How much a pose s, Rbar, T explains beyond its own triple:
//
//     gain = log(A / (pi tol)) (sum_j omega_j^2 max(0, 1 - r_j^2 / tol) - 3)
//
// with tol = (threshold s)^2, residuals r_j = ||w_j - s Rbar S_j - T||, visible
// landmarks spread over an area A, and omega^2 of mean 1. The sum is the truncated one
// of MSAC; residuals count in units of the size of the shape. The logarithm is the
// log-probability of a landmark that keeps to its place, where a wrong one could be
// anywhere in A: without it a shape blown up far beyond the image finds some landmarks
// in its wide tolerance always. Three landmarks fit whatever they are.
//
// Each draw that gains more than all draws before is fitted to its inliers, and these
// are judged again; the better of the drawn and the fitted poses counts. Draws stop
// early by the share of inliers found. An image in which no triple determines a pose
// has no inliers.
#include "../base/registry.hpp"
#include "../base/vectors.hpp"
#include "../pose/rotation_step.hpp"

namespace shapefit {

// Landmarks of n images that agree with one pose of a known shape.
struct ConsensusData {
    Arguments& from;
    Tensor<const double> landmarks = from("landmarks", "n 2 p");  // W
    // omega^2, of mean 1 where not 0, which is hidden
    Matrix<const double> squares = from("squares", "n p");
    Matrix<const double> shape = from("shape", "3 p");  // S
    Vector<const uint64_t> seeds = from("seeds", "n");  // of the draws
    // of a residual, in units of the size of the shape
    double threshold = from("threshold");
    Index draws = from("draws");
    Index max_rounds = from("max_rounds");  // of fits of a pose to its inliers
    Matrix<bool> inliers = from("inliers", "n p");
};

namespace {

constexpr int TRIPLE = 3;
constexpr double FLAT = 1e-6;  // a triangle as flat as this determines no pose
constexpr double PI = 0x1.921fb54442d18p1;
// Triples of inliers to be expected among the draws, after which none is drawn any
// more. One would do for exact landmarks of the very shape; on made cars, whose shapes
// are not the mean and whose landmarks are noisy, 20 find the pose in as many images as
// 500 draws (to three digits, for 0 to 70% wrong landmarks) and 5 lose it in one of a
// hundred with 60% wrong.
constexpr double ENOUGH_INLIER_TRIPLES = 20;
// Draws from one check to the next, a multiple of every WIDTH.
constexpr Index CHECKED = 8;

// The visible landmarks of one image beside those of the shape, without the hidden
// ones.
struct VisibleLandmarks {
    VisibleLandmarks(Workspace& workspace, Index p)
        : x(workspace.zeros<double>(p)),
          y(workspace.zeros<double>(p)),
          h(workspace.zeros<double>(p)),
          index(workspace.zeros<int64_t>(p)) {
        for (double*& row : S) row = workspace.zeros<double>(p);
    }

    // Copy the landmarks of w (2, p) and S (3, p) with omega^2 > 0.
    void gather(Matrix<const double> w, Vector<const double> squares,
                Matrix<const double> shape) {
        count = 0;
        for (Index j = 0; j < squares.size[0]; ++j) {
            if (!(squares[j] > 0)) continue;
            const Index at = count++;
            x[at] = w[0][j];
            y[at] = w[1][j];
            h[at] = squares[j];
            for (int b = 0; b < 3; ++b) S[b][at] = shape[b][j];
            index[at] = j;
        }
    }

    Index count = 0;
    double *x, *y;   // w
    double* h;       // omega^2
    double* S[3];    // the shape
    int64_t* index;  // among all landmarks
};

// Three of the visible landmarks.
struct Triple {
    Index index[TRIPLE];
};

// A random integer of 0 .. m - 1, the same on every machine; `state` becomes the next
// one. SplitMix64 of Steele, Lea and Flood (2014).
Index draw_below(uint64_t& state, Index m) {
    state += 0x9E3779B97F4A7C15u;
    uint64_t z = state;
    z = (z ^ (z >> 30)) * 0xBF58476D1CE4E5B9u;
    z = (z ^ (z >> 27)) * 0x94D049BB133111EBu;
    z ^= z >> 31;
    return static_cast<Index>(((z >> 32) * static_cast<uint64_t>(m)) >> 32);
}

// Three different random integers of 0 .. m - 1, m >= 3, all ordered triples equally
// likely.
Triple draw_triple(uint64_t& state, Index m) {
    const Index i = draw_below(state, m);
    Index j = draw_below(state, m - 1), k = draw_below(state, m - 2);
    if (j >= i) ++j;
    const Index low = i < j ? i : j, high = i < j ? j : i;
    if (k >= low) ++k;
    if (k >= high) ++k;
    return {{i, j, k}};
}

// A pose x -> s Rbar x + T, or one a lane.
template <class Number>
struct Pose {
    Number size;  // s, 0 where the triple determines no pose
    RotationOf<Number> R;
    Number T[2];
};

// What residuals are measured by.
struct Tolerance {
    double threshold;
    double area;
};

// The three landmarks of each triple: the first, and the others seen from it.
struct TripleLanes {
    Doubles w[2], S[3];
    Doubles to_w[2][2], to_S[2][3];
};

// Copy the landmarks and shape points of WIDTH triples into lanes.
[[gnu::noinline]] void gather(const VisibleLandmarks& visible, const Triple* triples,
                              TripleLanes& lanes) {
    const double* w[2] = {visible.x, visible.y};
    for (int l = 0; l < WIDTH; ++l) {
        const Index i = triples[l].index[0];
        for (int a = 0; a < 2; ++a) lanes.w[a][l] = w[a][i];
        for (int b = 0; b < 3; ++b) lanes.S[b][l] = visible.S[b][i];
        for (int other = 0; other < 2; ++other) {
            const Index j = triples[l].index[1 + other];
            for (int a = 0; a < 2; ++a) lanes.to_w[other][a][l] = w[a][j] - w[a][i];
            for (int b = 0; b < 3; ++b)
                lanes.to_S[other][b][l] = visible.S[b][j] - visible.S[b][i];
        }
    }
}

// The plane of a triangle in the shape.
struct Plane {
    RotationOf<Doubles> Q;        // an orthonormal basis, and the normal
    Doubles base, along, height;  // to_S = base Q_0 and along Q_0 + height Q_1
};

// The plane of the three shape points of each triple, in an orthonormal basis.
Plane plane_of(const TripleLanes& triple) {
    Plane plane;
    plane.base = root(inner3(triple.to_S[0], triple.to_S[0]));
    for (int b = 0; b < 3; ++b) plane.Q[b] = triple.to_S[0][b] / plane.base;
    plane.along = inner3<Doubles>(plane.Q, triple.to_S[1]);
    for (int b = 0; b < 3; ++b)
        plane.Q[3 + b] = triple.to_S[1][b] - plane.along * plane.Q[b];
    plane.height = root(inner3(plane.Q + 3, plane.Q + 3));
    plane.Q.orthonormalise();
    return plane;
}

// Find both weak perspective poses of each of WIDTH triples.
void pose_triples(const VisibleLandmarks& visible, const Triple* triples,
                  Pose<Doubles> poses[2]) {
    TripleLanes triple{};
    gather(visible, triples, triple);
    const Plane plane = plane_of(triple);
    Doubles G[2][2], normal[2];
    for (int a = 0; a < 2; ++a) {
        G[a][0] = triple.to_w[0][a] / plane.base;
        G[a][1] = (triple.to_w[1][a] - plane.along * G[a][0]) / plane.height;
    }
    const Doubles xx = square(G[0][0]) + square(G[0][1]),
                  yy = square(G[1][0]) + square(G[1][1]);
    const Doubles xy = G[0][0] * G[1][0] + G[0][1] * G[1][1];
    const Doubles largest = 0.5 * (xx + yy + root(square(xx - yy) + 4.0 * square(xy)));
    const Doubles s = root(largest), zero{};
    normal[0] = root(larger(largest - xx, zero));
    normal[1] = root(larger(largest - yy, zero));
    normal[1] = xy > 0 ? -normal[1] : normal[1];
    const Doubles flat = FLAT * larger(plane.base, magnitude(plane.along));
    const Doubles size =
        plane.base > 0 ? (plane.height > flat ? (largest > 0 ? s : zero) : zero) : zero;
    for (int side = 0; side < 2; ++side) {
        Pose<Doubles>& pose = poses[side];
        const double sign = 1 - 2 * side;
        pose.size = size;
        for (int a = 0; a < 2; ++a)
            for (int b = 0; b < 3; ++b)
                pose.R[3 * a + b] = (G[a][0] * plane.Q[b] + G[a][1] * plane.Q[3 + b] +
                                     sign * normal[a] * plane.Q[6 + b]) /
                                    s;
        pose.R.orthonormalise();
        for (int a = 0; a < 2; ++a)
            pose.T[a] = triple.w[a] - s * inner3(pose.R + 3 * a, triple.S);
    }
}

// 12 sqrt(det Cov) of the visible landmarks: the area of a rectangle with their
// covariance.
double find_area(const VisibleLandmarks& visible) {
    const Index m = visible.count;
    double x = 0, y = 0, xx = 0, yy = 0, xy = 0;
    for (Index j = 0; j < m; ++j) {
        x += visible.x[j] / m;
        y += visible.y[j] / m;
    }
    for (Index j = 0; j < m; ++j) {
        xx += square(visible.x[j] - x) / m;
        yy += square(visible.y[j] - y) / m;
        xy += (visible.x[j] - x) * (visible.y[j] - y) / m;
    }
    return 12 * root(larger(xx * yy - xy * xy, 0));
}

// The gain of a pose, or of one a lane; -infinity where the triple determined no pose,
// and where the tolerance covers the whole area. Calls visit(j, r_j^2, tol) for each
// landmark.
template <class Number, class Visit>
[[gnu::always_inline]] inline Number evaluate(const VisibleLandmarks& visible,
                                              const Pose<Number>& pose,
                                              const Tolerance& tolerance,
                                              const Visit& visit) {
    const Number limit = square(tolerance.threshold * pose.size), inverse = 1 / limit,
                 zero{};
    Number M[6], total = zero - TRIPLE;
    for (int e = 0; e < 6; ++e) M[e] = pose.size * pose.R[e];
    const Number Tx = pose.T[0], Ty = pose.T[1];
    for (Index j = 0; j < visible.count; ++j) {
        const double X = visible.S[0][j], Y = visible.S[1][j], Z = visible.S[2][j];
        const Number x = visible.x[j] - Tx - M[0] * X - M[1] * Y - M[2] * Z;
        const Number y = visible.y[j] - Ty - M[3] * X - M[4] * Y - M[5] * Z;
        const Number residual = x * x + y * y;
        total += visible.h[j] * larger(1 - residual * inverse, zero);
        visit(j, residual, limit);
    }
    // area / (pi limit) > 1 where the logarithm counts
    const Number more = tolerance.area * inverse / PI - 1;
    return pose.size > 0 ? (more > 0 ? total * logarithm(1 + more) : zero - INFINITE)
                         : zero - INFINITE;
}

// The gain of one pose; sets inside (count,) to 1 for the landmarks in its tolerance,
// else 0, and to 0 for all where the gain is -infinity.
double evaluate_one(const VisibleLandmarks& visible, const Pose<double>& pose,
                    const Tolerance& tolerance, double* __restrict inside) {
    const double gain =
        evaluate(visible, pose, tolerance, [=](Index j, double residual, double limit) {
            inside[j] = residual <= limit ? 1.0 : 0.0;
        });
    for (Index j = 0; j < visible.count && gain == -INFINITE; ++j) inside[j] = 0;
    return gain;
}

// S Omega^2 S^T and w Omega^2 S^T of the inliers about their weighted means, and the
// means.
struct Moments {
    double P[9];
    double D[6];
    double middle[3];  // of the shape
    double origin[2];  // of the landmarks
};

// The moments of the inliers, the landmarks with inside (count,) = 1, else 0.
Moments find_moments(const VisibleLandmarks& visible, const double* inside) {
    Moments moments{};
    const double* w[2] = {visible.x, visible.y};
    double total = 0;
    for (Index j = 0; j < visible.count; ++j) {
        const double share = visible.h[j] * inside[j];
        total += share;
        for (int b = 0; b < 3; ++b) moments.middle[b] += share * visible.S[b][j];
        for (int a = 0; a < 2; ++a) moments.origin[a] += share * w[a][j];
    }
    for (double& x : moments.middle) x /= total;
    for (double& x : moments.origin) x /= total;
    for (Index j = 0; j < visible.count; ++j) {
        const double share = visible.h[j] * inside[j];
        double S[3];
        for (int b = 0; b < 3; ++b) S[b] = visible.S[b][j] - moments.middle[b];
        for (int b = 0; b < 3; ++b) {
            for (int a = 0; a < 3; ++a) moments.P[3 * a + b] += share * S[a] * S[b];
            for (int a = 0; a < 2; ++a)
                moments.D[3 * a + b] += share * S[b] * (w[a][j] - moments.origin[a]);
        }
    }
    return moments;
}

// The landmarks inside the tolerance of a pose, now and before; 1 or 0 for each.
struct Inside {
    double *now, *before;
};

// How many of n numbers, each 0 or 1, differ.
Index count_differences(const double* a, const double* b, Index n) {
    double total = 0;
    for (Index j = 0; j < n; ++j) total += magnitude(a[j] - b[j]);
    return static_cast<Index>(total);
}

// sum_j x_j
double sum(const double* x, Index n) {
    double total = 0;
    for (Index j = 0; j < n; ++j) total += x[j];
    return total;
}

// What the search in an image has found so far.
struct Best {
    double drawn = -INFINITE;  // gain of the best pose as drawn,
    double gain = -INFINITE;   // and of the best of all, drawn or fitted to inliers,
    Index inliers = 0;         // with so many
};

// Write the inliers of a pose where it gains more than the best before it.
void keep_better(const VisibleLandmarks& visible, double gain, const double* inside,
                 Best& best, Vector<bool> inliers) {
    if (!(gain > best.gain)) return;
    best.gain = gain;
    best.inliers = static_cast<Index>(sum(inside, visible.count));
    for (Index j = 0; j < visible.count; ++j) inliers[visible.index[j]] = inside[j] > 0;
}

// Fit a drawn pose to its inliers and find these again, until they do not change or
// max_rounds times; the inliers of the best pose are written. A pose with no inliers
// but its triple is not fitted.
void refine_pose(const VisibleLandmarks& visible, const Tolerance& tolerance,
                 Index max_rounds, Pose<double>& pose, Inside& inside, Best& best,
                 Vector<bool> inliers) {
    keep_better(visible, evaluate_one(visible, pose, tolerance, inside.now), inside.now,
                best, inliers);
    for (Index round = 0; round < max_rounds && sum(inside.now, visible.count) > TRIPLE;
         ++round) {
        const Moments moments = find_moments(visible, inside.now);
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
        keep_better(visible, evaluate_one(visible, pose, tolerance, inside.now),
                    inside.now, best, inliers);
        if (!count_differences(inside.now, before, visible.count)) break;
    }
}

// The share of the triples of m landmarks that are triples of `inliers` of them.
double share_of_triples(Index inliers, Index m) {
    double share = 1;
    for (Index drawn = 0; drawn < TRIPLE; ++drawn)
        share *= static_cast<double>(inliers - drawn) / static_cast<double>(m - drawn);
    return larger(share, 0);
}

// The pose in a lane.
Pose<double> pose_of_lane(const Pose<Doubles>& poses, int lane) {
    Pose<double> pose;
    pose.size = poses.size[lane];
    for (int e = 0; e < 9; ++e) pose.R[e] = poses.R[e][lane];
    for (int a = 0; a < 2; ++a) pose.T[a] = poses.T[a][lane];
    return pose;
}

// Evaluate both poses of `count` triples, and refine each that gains more than all
// drawn before it.
void evaluate_triples(const VisibleLandmarks& visible, const Triple* triples, int count,
                      Index max_rounds, const Tolerance& tolerance, Best& best,
                      Inside& inside, Vector<bool> inliers) {
    Pose<Doubles> poses[2];
    Doubles gains[2];
    pose_triples(visible, triples, poses);
    for (int side = 0; side < 2; ++side)
        gains[side] =
            evaluate(visible, poses[side], tolerance, [](Index, Doubles, Doubles) {});
    for (int lane = 0; lane < count; ++lane)
        for (int side = 0; side < 2; ++side) {
            if (!(gains[side][lane] > best.drawn)) continue;
            best.drawn = gains[side][lane];
            Pose<double> pose = pose_of_lane(poses[side], lane);
            refine_pose(visible, tolerance, max_rounds, pose, inside, best, inliers);
        }
}

// Write the inliers of an image: the landmarks that agree with the best of the poses
// that random triples determine.
void search_image(const VisibleLandmarks& visible, const ConsensusData& data,
                  uint64_t state, Inside& inside, Vector<bool> inliers) {
    const Tolerance tolerance{data.threshold, find_area(visible)};
    Best best;
    Triple triples[WIDTH] = {};
    for (Index drawn = 0; drawn < data.draws; drawn += WIDTH) {
        if (drawn % CHECKED == 0) check_interrupt();
        // Stop by the inlier ratio: triples of inliers have been drawn often enough.
        const double good =
            drawn % CHECKED ? 0 : share_of_triples(best.inliers, visible.count);
        if (static_cast<double>(drawn) * good >= ENOUGH_INLIER_TRIPLES) break;
        const int count =
            static_cast<int>(data.draws - drawn < WIDTH ? data.draws - drawn : WIDTH);
        for (int lane = 0; lane < count; ++lane)
            triples[lane] = draw_triple(state, visible.count);
        evaluate_triples(visible, triples, count, data.max_rounds, tolerance, best,
                         inside, inliers);
    }
}

}  // namespace

// Write the inliers of each image of the range, found by random triples of landmarks.
void find_consensus(const ConsensusData& data, Range range) {
    const Index p = data.squares.size[1];
    Workspace workspace;
    VisibleLandmarks visible(workspace, p);
    Inside inside{workspace.zeros<double>(p), workspace.zeros<double>(p)};
    for (Index image = range.first; image < range.last; ++image) {
        const Vector<bool> inliers = data.inliers[image];
        for (Index j = 0; j < p; ++j) inliers[j] = false;
        visible.gather(data.landmarks[image], data.squares[image], data.shape);
        if (visible.count >= TRIPLE)
            search_image(visible, data, data.seeds[image], inside, inliers);
    }
}

const Exported<find_consensus> find_consensus_exported{"find_consensus"};

}  // namespace shapefit
