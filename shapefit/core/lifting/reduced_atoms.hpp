// The atoms of an image in reduced coordinates, laid out twice: by atom, and with atoms innermost.
#pragma once

#include "../algebra/lanes.hpp"
#include "../algebra/workspace.hpp"
#include "../convex/reduction.hpp"

namespace shapefit::SHAPEFIT_LEVEL {

struct ReducedAtoms {
    long k;             // atoms
    long q = 0;         // coordinates of a row; those up to `row` are zeros
    long row = 0;
    long padded_atoms;  // the atoms from k on are zeros
    double* rows;       // B (k, 3, row)
    double* planes;     // B (3 q, padded_atoms)

    // Room for k atoms of up to p coordinates.
    ReducedAtoms(Workspace& workspace, long k, long p);

    const double* atom(long i) const { return rows + i * 3 * row; }

    // Take atoms (k, 3, p) weighted and without translation.
    void reduce(Tensor<const double> atoms, const double* omega, const Reduction& reduction);

    // Take atoms (k, 3, q) as they are.
    void copy(Tensor<const double> atoms);

  private:
    void resize(long coordinates);
    void lay_planes();
};

}  // namespace shapefit::SHAPEFIT_LEVEL
