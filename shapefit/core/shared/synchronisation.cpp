#include "synchronisation.hpp"

#include "../base/registry.hpp"
#include "../base/lanes.hpp"
#include "../base/memory.hpp"
#include "../pose/rotation.hpp"

namespace shapefit {
namespace {

constexpr int STARTS = 4;  // the sum of all transforms, and the largest ones
constexpr double STILL = 1e-13;  // largest entry of the last change of Rbar
constexpr double SAME = 1e-6;    // and of the difference to a maximum that another start has found
constexpr int MOST_ROUNDS = 2000;
constexpr double RANK_ONE = 1e-8;  // s1 s2 / (s1^2 + s2^2) below which rounding hides the second

double squared_norm(const double* M) {
    double total = 0;
    for (int e = 0; e < 6; ++e) total += square(M[e]);
    return total;
}

bool is_near(const double* R, const double* other, double most) {
    double change = 0;
    for (int e = 0; e < 9; ++e) change = larger(change, magnitude(R[e] - other[e]));
    return change <= most;
}

// As `climb`; what comes near the maximum at `known` stops there, with the value 0.
double climb_elsewhere(Tensor<const double> blocks, const double* known, Matrix<double> R) {
    double value = 0;
    for (int round = 0; round < MOST_ROUNDS; ++round) {
        double total[6] = {}, before[9];
        value = 0;
        for (long i = 0; i < blocks.size[0]; ++i) {
            const double* M = blocks[i].data;
            double inner = 0;
            for (int e = 0; e < 6; ++e) inner += M[e] * R.data[e];
            if (inner <= 0) continue;
            value += square(inner);
            for (int e = 0; e < 6; ++e) total[e] += inner * M[e];
        }
        for (int e = 0; e < 9; ++e) before[e] = R.data[e];
        if (!polar_rotation({total, {2, 3}}, R) || is_near(R.data, before, STILL)) break;
        if (known && is_near(R.data, known, SAME)) return 0;
    }
    return value;
}

// Climb from the sum of all blocks (k, 2, 3) and from the largest ones; the best goes to R.
void synchronise_image(Tensor<const double> blocks, double* norms, double* R) {
    double start[6] = {}, trial[9];
    for (long i = 0; i < blocks.size[0]; ++i) {
        norms[i] = squared_norm(blocks[i].data);
        for (int e = 0; e < 6; ++e) start[e] += blocks[i].data[e];
    }
    double best = -1;
    for (int round = 0; round < STARTS; ++round) {
        if (round > 0) {
            if (blocks.size[0] == 0) break;
            long longest = 0;
            for (long i = 1; i < blocks.size[0]; ++i)
                if (norms[i] > norms[longest]) longest = i;
            if (norms[longest] <= 0) break;
            norms[longest] = 0;
            for (int e = 0; e < 6; ++e) start[e] = blocks[longest].data[e];
        }
        if (!polar_rotation({start, {2, 3}}, {trial, {3, 3}})) continue;
        const double value = climb_elsewhere(blocks, best < 0 ? nullptr : R, {trial, {3, 3}});
        if (value > best) {
            best = value;
            for (int e = 0; e < 9; ++e) R[e] = trial[e];
        }
    }
}

// A = sqrt(trace) u v^T: any unit vector orthogonal to v serves for the second direction.
void polar_of_rank_one(const double* A, double xx, double yy, double xy, double* R) {
    const double trace = xx + yy;
    const double u0 = root(xx / trace), u1 = copysign(root(yy / trace), xy);
    double v[3], axis[3] = {}, other[3];
    for (int b = 0; b < 3; ++b) v[b] = (u0 * A[b] + u1 * A[3 + b]) / root(trace);
    int least = 0;
    for (int b = 1; b < 3; ++b)
        if (magnitude(v[b]) < magnitude(v[least])) least = b;
    axis[least] = 1;
    cross(v, axis, other);
    const double length = root(square(other[0]) + square(other[1]) + square(other[2]));
    for (int b = 0; b < 3; ++b) {
        R[b] = u0 * v[b] - u1 * other[b] / length;
        R[3 + b] = u1 * v[b] + u0 * other[b] / length;
    }
}

}  // namespace

void synchronise(const SynchronisationData& data, Range range) {
    Workspace workspace;
    long most = 0;
    for (long image = range.first; image < range.last; ++image)
        if (data.transforms.count[image] > most) most = data.transforms.count[image];
    double* norms = workspace.zeros<double>(most);
    for (long image = range.first; image < range.last; ++image) {
        const ImageTransforms M = data.transforms[image];
        synchronise_image({M.blocks, {M.count, 2, 3}}, norms, data.rotation[image].data);
    }
}

double climb(Tensor<const double> blocks, Matrix<double> R) {
    return climb_elsewhere(blocks, nullptr, R);
}

bool polar_rotation(Matrix<const double> matrix, Matrix<double> R) {
    const double* A = matrix.data;
    double xx = 0, yy = 0, xy = 0, normal[3];
    for (int b = 0; b < 3; ++b) {
        xx += square(A[b]);
        yy += square(A[3 + b]);
        xy += A[b] * A[3 + b];
    }
    const double trace = xx + yy;
    if (!(trace > 0)) return false;
    cross(A, A + 3, normal);
    const double product = root(square(normal[0]) + square(normal[1]) + square(normal[2]));
    if (product > RANK_ONE * trace) {
        const double scale = 1 / (product * root(trace + 2 * product));
        for (int b = 0; b < 3; ++b) {
            R.data[b] = scale * ((yy + product) * A[b] - xy * A[3 + b]);
            R.data[3 + b] = scale * ((xx + product) * A[3 + b] - xy * A[b]);
        }
    } else {
        polar_of_rank_one(A, xx, yy, xy, R.data);
    }
    cross(R.data, R.data + 3, R.data + 6);
    return true;
}

const Exported<climb> climb_exported{"climb", PART};
const Exported<synchronise> synchronise_exported{"synchronise"};
const Exported<polar_rotation> polar_rotation_exported{"polar_rotation", PART};

}  // namespace shapefit
