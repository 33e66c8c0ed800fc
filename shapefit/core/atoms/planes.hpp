// Atoms with the atoms innermost, and their correlation with a dual point.
//
// Blocks of all atoms lie as six rows of `padded` numbers: entry (a, b) of block i is in row
// 3 a + b, so that loops over atoms vectorise. Zero atoms fill the last vector. The atoms themselves
// lie PADDING together, in the order in which they are read.
#pragma once

#include "../base/lanes.hpp"
#include "../base/workspace.hpp"
#include "reduction.hpp"

namespace shapefit {

struct Planes {
    double* data = nullptr;  // (padded / PADDING, columns, 3, PADDING)
    long columns = 0;
    long padded_atoms = 0;

    // Entry (b, j) of atoms i, i + 1, ... up to the next multiple of PADDING.
    double* at(int b, long j, long i) const {
        return data + ((i / PADDING * columns + j) * 3 + b) * PADDING + i % PADDING;
    }
};

// B (k, 3, p) as planes.
Planes turn_atoms(Tensor<const double> atoms, Workspace& workspace);

// The reduced atoms (B_i o omega)(I - h h^T), scaled so that the largest norm is 1; returns that
// norm, 1 if it is 0. `all` are those of turn_atoms, omega (p,); `reduced` has room for p columns
// and takes as many as there are coordinates.
double reduce_atoms(const Planes& all, const double* omega, const Reduction& reduction,
                    Planes& reduced);

// N_i = Y B_i^T for all atoms: rows y0, y1 of Y (2, columns), N (6, padded).
void correlate(const Planes& B, const double* y0, const double* y1, double* N);

}  // namespace shapefit
