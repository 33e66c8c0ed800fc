#include "atom_update.hpp"

#include "../algebra/vectors.hpp"
#include "../algebra/workspace.hpp"

namespace shapefit::SHAPEFIT_LEVEL {
namespace {

// The normal equations of the atoms: A (k, k) and D (k, width) in padded rows.
struct Normal {
    double *A, *D;
    long width;
};

// Coefficients are few: shape by shape, those that are not 0 add their products.
void add_products(const AtomUpdateData& data, long* used, const Normal& normal) {
    const long k = data.atoms.size[0], d = data.atoms.size[1];
    for (long shape = 0; shape < data.shapes.size[0]; ++shape) {
        const double *c = data.coefficients[shape].data, *x = data.shapes[shape].data;
        long m = 0;
        for (long i = 0; i < k; ++i) {
            used[m] = i;
            m += c[i] != 0;
        }
        for (long e = 0; e < m; ++e) {
            const double share = c[used[e]];
            double* __restrict A = normal.A + used[e] * k;
            double* __restrict D = normal.D + used[e] * normal.width;
            for (long f = 0; f < m; ++f) A[used[f]] += share * c[used[f]];
            for (long j = 0; j < d; ++j) D[j] += share * x[j];
        }
    }
}

}  // namespace

void update_atoms(const AtomUpdateData& data) {
    const long k = data.atoms.size[0], d = data.atoms.size[1], width = padded(d);
    Workspace workspace;
    const Normal normal{workspace.zeros<double>(k * k), workspace.zeros<double>(k * width), width};
    add_products(data, workspace.zeros<long>(k + 1), normal);
    double* B = workspace.zeros<double>(k * width);
    double* mixed = workspace.zeros<double>(width);
    for (long i = 0; i < k; ++i)
        for (long j = 0; j < d; ++j) B[i * width + j] = data.atoms[i][j];
    for (long sweep = 0; sweep < data.sweeps; ++sweep)
        for (long i = 0; i < k; ++i) {
            const double *A = normal.A + i * k, *D = normal.D + i * width;
            if (!(A[i] > 0)) continue;
            double* __restrict one = B + i * width;
            mix_rows(A, k, B, width, width, mixed);
            for (long j = 0; j < width; ++j) one[j] += (D[j] - mixed[j]) / A[i];
            const double norm = root(dot_padded(one, one, width));
            const double scale = data.bound / larger(norm, data.bound);
            for (long j = 0; j < width; ++j) one[j] *= scale;
        }
    for (long i = 0; i < k; ++i)
        for (long j = 0; j < d; ++j) data.atoms[i][j] = B[i * width + j];
}

}  // namespace shapefit::SHAPEFIT_LEVEL
