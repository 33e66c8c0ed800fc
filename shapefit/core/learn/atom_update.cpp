#include "atom_update.hpp"

#include "../base/registry.hpp"
#include "../base/vectors.hpp"
#include "../base/workspace.hpp"

namespace shapefit {
namespace {

// The rows of a matrix, padded with zeros to whole vectors.
double* padded_rows(Workspace& workspace, Matrix<const double> rows, long width) {
    double* padded = workspace.zeros<double>(rows.size[0] * width);
    for (long i = 0; i < rows.size[0]; ++i)
        for (long j = 0; j < rows.size[1]; ++j) padded[i * width + j] = rows[i][j];
    return padded;
}

}  // namespace

// Coefficients are few: those that are not 0 add their products.
void add_products(const ProductsData& data) {
    const long k = data.overlaps.size[0], d = data.pulls.size[1];
    Workspace workspace;
    long* used = workspace.zeros<long>(k + 1);
    for (long shape = 0; shape < data.shapes.size[0]; ++shape) {
        const double *c = data.coefficients[shape].data, *x = data.shapes[shape].data;
        long m = 0;
        for (long i = 0; i < k; ++i) {
            used[m] = i;
            m += c[i] != 0;
        }
        for (long e = 0; e < m; ++e) {
            const double share = c[used[e]];
            double* __restrict A = data.overlaps[used[e]].data;
            double* __restrict D = data.pulls[used[e]].data;
            for (long f = 0; f < m; ++f) A[used[f]] += share * c[used[f]];
            for (long j = 0; j < d; ++j) D[j] += share * x[j];
        }
    }
}

void update_atoms(const AtomUpdateData& data) {
    const long k = data.atoms.size[0], d = data.atoms.size[1], width = padded(d);
    Workspace workspace;
    const double* pulls = padded_rows(workspace, data.pulls, width);
    double* B = padded_rows(workspace, data.atoms, width);
    double* mixed = workspace.zeros<double>(width);
    for (long sweep = 0; sweep < data.sweeps; ++sweep)
        for (long i = 0; i < k; ++i) {
            const double *A = data.overlaps[i].data, *D = pulls + i * width;
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

const Exported<add_products> add_products_exported{"add_products"};
const Exported<update_atoms> update_atoms_exported{"update_atoms"};

}  // namespace shapefit
