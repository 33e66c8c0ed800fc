#include "reduced_atoms.hpp"

namespace shapefit::SHAPEFIT_LEVEL {

ReducedAtoms::ReducedAtoms(Workspace& workspace, long k, long p)
    : k(k),
      padded_atoms(padded(k)),
      rows(workspace.zeros<double>(k * 3 * padded(p))),
      planes(workspace.zeros<double>(3 * p * padded_atoms)) {}

void ReducedAtoms::reduce(Tensor<const double> atoms, const double* omega,
                          const Reduction& reduction) {
    resize(reduction.coordinates());
    for (long i = 0; i < k; ++i)
        for (int b = 0; b < 3; ++b) reduction.reduce(atoms[i][b].data, omega, rows + (3 * i + b) * row);
    lay_planes();
}

void ReducedAtoms::copy(Tensor<const double> atoms) {
    resize(atoms.size[2]);
    for (long i = 0; i < k; ++i)
        for (int b = 0; b < 3; ++b)
            for (long j = 0; j < q; ++j) rows[(3 * i + b) * row + j] = atoms[i][b][j];
    lay_planes();
}

void ReducedAtoms::resize(long coordinates) {
    q = coordinates;
    row = padded(q);
    for (long r = 0; r < 3 * k; ++r)
        for (long j = q; j < row; ++j) rows[r * row + j] = 0;
}

void ReducedAtoms::lay_planes() {
    for (long i = 0; i < k; ++i)
        for (int b = 0; b < 3; ++b)
            for (long j = 0; j < q; ++j)
                planes[(b * q + j) * padded_atoms + i] = rows[(3 * i + b) * row + j];
}

}  // namespace shapefit::SHAPEFIT_LEVEL
