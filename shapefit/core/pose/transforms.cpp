#include "transforms.hpp"

#include "../base/registry.hpp"
#include "../base/small_matrices.hpp"
#include "../convex/blocks.hpp"
#include "../global/objective.hpp"

namespace shapefit {

// argmin sum_i ||M_i - c_i Rbar||_F^2 over c >= 0 and Rbar Rbar^T = I, for each image.
struct SynchronisationData {
    Arguments& from;
    GivenTransforms transforms{from};  // M
    // R, left alone where all M_i are 0
    Tensor<double> rotation = from("rotation", "n 3 3");
};

// S = sum_i c_i R_i B_i and its parts, for each image.
struct ReconstructionData {
    Arguments& from;
    GivenTransforms transforms{from};                     // M
    Tensor<const double> atoms = from("atoms", "k 3 p");  // B
    Vector<double> sizes = from("sizes", "a");  // c_i = ||M_i||_2 of each transform
    Tensor<double> shapes = from("shapes", "n 3 p");  // S
    // left alone where none is known
    Tensor<double> rotation = from("rotation", "n 3 3");
    // number of atoms that are not negligible
    Vector<int64_t> active = from("active", "n");
    // whether their transforms are all orthogonal
    Vector<bool> tight = from("tight", "n");
};

namespace {

constexpr int STARTS = 4;        // the sum of all transforms, and the largest ones
constexpr double STILL = 1e-13;  // largest entry of the last change of Rbar
// And of the difference to a maximum that another start has found.
constexpr double SAME = 1e-6;
constexpr int MAX_ROUNDS = 2000;
// S1 s2 / (s1^2 + s2^2) below which rounding hides the second.
constexpr double RANK_ONE = 1e-8;
// An atom is active where its coefficient is more than this share of the largest one.
constexpr double ACTIVE = 1e-6;
// A transform is orthogonal where ||M M^T / c^2 - I||_F is at most this.
constexpr double ORTHOGONAL = 1e-3;

// ||M||_F^2 of M (2, 3).
double squared_norm(const double* M) {
    double total = 0;
    for (int e = 0; e < 6; ++e) total += square(M[e]);
    return total;
}

// Whether no entry of two rotations differs by more than `most`.
bool is_near(const double* R, const double* other, double most) {
    double change = 0;
    for (int e = 0; e < 9; ++e) change = larger(change, magnitude(R[e] - other[e]));
    return change <= most;
}

// Move R to a local maximum of sum_i max(0, <M_i, Rbar>)^2, blocks M (k, 2, 3); returns
// the maximum, or 0 as soon as R comes near the rotation `known`, a maximum found
// before.
//
// The sum is convex in Rbar, so that the maximiser of its linearisation, the polar
// factor of sum_i max(0, <M_i, Rbar>) M_i, never lowers it.
double ascend(Tensor<const double> blocks, const Rotation* known, Rotation& R) {
    double value = 0;
    for (int round = 0; round < MAX_ROUNDS; ++round) {
        double total[6] = {};
        value = 0;
        for (Index i = 0; i < blocks.size[0]; ++i) {
            const double* M = blocks[i].data;
            double inner = 0;
            for (int e = 0; e < 6; ++e) inner += M[e] * R[e];
            if (inner <= 0) continue;
            value += square(inner);
            for (int e = 0; e < 6; ++e) total[e] += inner * M[e];
        }
        const Rotation before = R;
        if (!polar_rotation(total, R) || is_near(R, before, STILL)) break;
        if (known && is_near(R, *known, SAME)) return 0;
    }
    return value;
}

// Set R to the best of the local maxima of sum_i max(0, <M_i, Rbar>)^2 from several
// starts: the sum of all blocks M (k, 2, 3), and the largest of them. norms (k,) is
// scratch memory.
void synchronise_image(Tensor<const double> blocks, double* norms, Rotation& R) {
    double start[6] = {};
    Rotation trial;
    for (Index i = 0; i < blocks.size[0]; ++i) {
        norms[i] = squared_norm(blocks[i].data);
        for (int e = 0; e < 6; ++e) start[e] += blocks[i].data[e];
    }
    double best = -1;
    for (int round = 0; round < STARTS; ++round) {
        if (round > 0) {
            if (blocks.size[0] == 0) break;
            Index longest = 0;
            for (Index i = 1; i < blocks.size[0]; ++i)
                if (norms[i] > norms[longest]) longest = i;
            if (norms[longest] <= 0) break;
            norms[longest] = 0;
            for (int e = 0; e < 6; ++e) start[e] = blocks[longest].data[e];
        }
        if (!polar_rotation(start, trial)) continue;
        const double value = ascend(blocks, best < 0 ? nullptr : &R, trial);
        if (value > best) {
            best = value;
            R = trial;
        }
    }
}

// Set the first two rows of R to a polar factor of A (2, 3) of rank one, with A A^T =
// [[xx, xy], [xy, yy]]: A = sqrt(trace) u v^T, and any unit vector orthogonal to v
// serves for the second direction.
void polar_of_rank_one(const double* A, double xx, double yy, double xy, Rotation& R) {
    const double trace = xx + yy;
    const double u0 = root(xx / trace), u1 = copysign(root(yy / trace), xy);
    double v[3], axis[3] = {}, other[3];
    for (int b = 0; b < 3; ++b) v[b] = (u0 * A[b] + u1 * A[3 + b]) / root(trace);
    int least = 0;
    for (int b = 1; b < 3; ++b)
        if (magnitude(v[b]) < magnitude(v[least])) least = b;
    axis[least] = 1;
    cross(v, axis, other);
    const double length = root(inner3(other, other));
    for (int b = 0; b < 3; ++b) {
        R[b] = u0 * v[b] - u1 * other[b] / length;
        R[3 + b] = u1 * v[b] + u0 * other[b] / length;
    }
}

// s1^2 + s2^2, s1 s2 and s1^2 - s2^2 of the singular values of M (2, 3).
Invariants<double> invariants_of(const double* M) {
    return invariants<double>({M[0], M[1], M[2], M[3], M[4], M[5]});
}

// c R from M (2, 3) = c times the first two rows of R.
Rotation scaled_rotation(const double* M, double c) {
    Rotation cR = Rotation::from(M, 2);
    cR.complete();
    for (int b = 0; b < 3; ++b) cR[6 + b] = c > 0 ? cR[6 + b] / c : 0;
    return cR;
}

// ||M M^T / c^2 - I||_F of M (2, 3).
double skewness(const double* M, double c) {
    const double xx = inner3(M, M) / (c * c), yy = inner3(M + 3, M + 3) / (c * c);
    return root(square(xx - 1) + square(yy - 1) +
                2 * square(inner3(M, M + 3) / (c * c)));
}

// S += c R B for an atom B (3, p), cR (3, 3).
void add_shape(const double* cR, Matrix<const double> B, Matrix<double> S) {
    const Index p = S.size[1];
    for (int a = 0; a < 3; ++a) {
        const double *row = cR + 3 * a, *b = B.data;
        double* __restrict s = S[a].data;
        for (Index j = 0; j < p; ++j)
            s[j] += row[0] * b[j] + row[1] * b[p + j] + row[2] * b[2 * p + j];
    }
}

// Write the shape, coefficients and rotation that the transforms of an image give.
void reconstruct_image(const ReconstructionData& data, Index image) {
    const ImageTransforms M = data.transforms[image];
    double* sizes = data.sizes.data + data.transforms.first[image];
    double largest = 0, total[9] = {};
    for (Index e = 0; e < M.count; ++e) {
        sizes[e] = spectral_norm(invariants_of(M.blocks + 6 * e));
        largest = larger(largest, sizes[e]);
    }
    Index active = 0;
    bool loose = false;
    for (Index e = 0; e < M.count; ++e) {
        const double* block = M.blocks + 6 * e;
        const Rotation cR = scaled_rotation(block, sizes[e]);
        add_shape(cR, data.atoms[M.atom[e]], data.shapes[image]);
        for (int i = 0; i < 9; ++i) total[i] += cR[i];
        if (!(sizes[e] > ACTIVE * largest)) continue;
        ++active;
        loose |= skewness(block, sizes[e]) > ORTHOGONAL;
    }
    data.active[image] = active;
    data.tight[image] = active > 0 && !loose;
    bool known = active > 0;
    for (const double entry : total) known &= is_finite(entry);
    if (known) nearest_rotation(total).write(data.rotation[image].data);
}

}  // namespace

bool polar_rotation(const double* A, Rotation& R) {
    const double xx = inner3(A, A), yy = inner3(A + 3, A + 3), xy = inner3(A, A + 3),
                 trace = xx + yy;
    double normal[3];
    if (!(trace > 0)) return false;
    cross(A, A + 3, normal);
    const double product = root(inner3(normal, normal));
    if (product > RANK_ONE * trace) {
        const double scale = 1 / (product * root(trace + 2 * product));
        for (int b = 0; b < 3; ++b) {
            R[b] = scale * ((yy + product) * A[b] - xy * A[3 + b]);
            R[3 + b] = scale * ((xx + product) * A[3 + b] - xy * A[b]);
        }
    } else {
        polar_of_rank_one(A, xx, yy, xy, R);
    }
    R.complete();
    return true;
}

Rotation nearest_rotation(const double* a) {
    const double yz = a[7] - a[5], zx = a[2] - a[6], xy = a[3] - a[1];
    double N[16] = {
        a[0] + a[4] + a[8], yz,          zx,          xy,          yz,
        a[0] - a[4] - a[8], a[1] + a[3], a[2] + a[6], zx,          a[1] + a[3],
        a[4] - a[0] - a[8], a[5] + a[7], xy,          a[2] + a[6], a[5] + a[7],
        a[8] - a[0] - a[4]};
    double values[4], V[16];
    symmetric_eigen({N, {4, 4}}, {values, {4}}, {V, {4, 4}});
    return rotation_of(V + 12);
}

// Write the one rotation that best fits all transforms of each image of the range, by a
// monotone fixed-point iteration: argmax sum_i max(0, <M_i, Rbar>)^2 over orthonormal
// rows.
void synchronise(const SynchronisationData& data, Range range) {
    Workspace workspace;
    Index most = 0;
    for (Index image = range.first; image < range.last; ++image)
        if (data.transforms.count[image] > most) most = data.transforms.count[image];
    double* norms = workspace.zeros<double>(most);
    for (Index image = range.first; image < range.last; ++image) {
        check_interrupt();
        const ImageTransforms M = data.transforms[image];
        Rotation R = Rotation::from(data.rotation[image].data);
        synchronise_image({M.blocks, {M.count, 2, 3}}, norms, R);
        R.write(data.rotation[image].data);
    }
}

// Write the shape S = sum_i c_i R_i B_i of each image of the range, and its parts. R_i
// completes M_i / c_i by the cross product of its rows.
void reconstruct(const ReconstructionData& data, Range range) {
    for (Index image = range.first; image < range.last; ++image) {
        check_interrupt();
        reconstruct_image(data, image);
    }
}

const Exported<synchronise> synchronise_exported{"synchronise"};
const Exported<reconstruct> reconstruct_exported{"reconstruct"};

}  // namespace shapefit
