#include "reconstruction.hpp"

#include "../base/registry.hpp"
#include "../base/small_matrices.hpp"
#include "../convex/blocks.hpp"
#include "../global/objective.hpp"
#include "rotation.hpp"
#include "../shared/synchronisation.hpp"

namespace shapefit {
namespace {

// An atom is active where its coefficient is more than this share of the largest one.
constexpr double ACTIVE = 1e-6;
// A transform is orthogonal where ||M M^T / c^2 - I||_F is at most this.
constexpr double ORTHOGONAL = 1e-3;

Invariants<double> invariants_of(const double* M) {
    return invariants<double>({M[0], M[1], M[2], M[3], M[4], M[5]});
}

// c R (3, 3) from M (2, 3) = c times the first two rows of R.
void turn(const double* M, double c, bool orthogonal, double* cR) {
    if (orthogonal && polar_rotation({M, {2, 3}}, {cR, {3, 3}})) {
        for (int e = 0; e < 9; ++e) cR[e] *= c;
        return;
    }
    for (int e = 0; e < 6; ++e) cR[e] = M[e];
    cross(cR, cR + 3, cR + 6);
    for (int b = 0; b < 3; ++b) cR[6 + b] = c > 0 ? cR[6 + b] / c : 0;
}

// ||M M^T / c^2 - I||_F.
double skewness(const double* M, double c) {
    const double xx = inner3(M, M) / (c * c), yy = inner3(M + 3, M + 3) / (c * c);
    return root(square(xx - 1) + square(yy - 1) + 2 * square(inner3(M, M + 3) / (c * c)));
}

// S += c R B.
void add_shape(const double* cR, Matrix<const double> B, Matrix<double> S) {
    const long p = S.size[1];
    for (int a = 0; a < 3; ++a) {
        const double *row = cR + 3 * a, *b = B.data;
        double* __restrict s = S[a].data;
        for (long j = 0; j < p; ++j)
            s[j] += row[0] * b[j] + row[1] * b[p + j] + row[2] * b[2 * p + j];
    }
}

void reconstruct_image(const ReconstructionData& data, long image) {
    const ImageTransforms M = data.transforms[image];
    double* sizes = data.sizes.data + data.transforms.first[image];
    double largest = 0, total[9] = {}, cR[9];
    for (long e = 0; e < M.count; ++e) {
        sizes[e] = spectral_norm(invariants_of(M.blocks + 6 * e));
        largest = larger(largest, sizes[e]);
    }
    long active = 0;
    bool loose = false;
    for (long e = 0; e < M.count; ++e) {
        const double* block = M.blocks + 6 * e;
        turn(block, sizes[e], data.orthogonal, cR);
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
    if (known) nearest_rotation({total, {3, 3}}, data.rotation[image]);
}

}  // namespace

void reconstruct(const ReconstructionData& data, Range range) {
    for (long image = range.first; image < range.last; ++image) reconstruct_image(data, image);
}

void nearest_rotation(Matrix<const double> A, Matrix<double> R) {
    const double* a = A.data;
    const double yz = a[7] - a[5], zx = a[2] - a[6], xy = a[3] - a[1];
    double N[16] = {a[0] + a[4] + a[8], yz, zx, xy,
                    yz, a[0] - a[4] - a[8], a[1] + a[3], a[2] + a[6],
                    zx, a[1] + a[3], a[4] - a[0] - a[8], a[5] + a[7],
                    xy, a[2] + a[6], a[5] + a[7], a[8] - a[0] - a[4]};
    double values[4], V[16];
    symmetric_eigen({N, {4, 4}}, {values, {4}}, {V, {4, 4}});
    rotation_of(V + 12, R.data);
}

const Exported<reconstruct> reconstruct_exported{"reconstruct"};
const Exported<nearest_rotation> nearest_rotation_exported{"nearest_rotation", PART};

}  // namespace shapefit
