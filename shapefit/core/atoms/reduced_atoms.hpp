// The atoms of an image in reduced coordinates: with the atoms innermost, and by atom where asked.
#pragma once

#include "../base/active_set.hpp"
#include "reduction.hpp"

namespace shapefit {

class ReducedAtoms {
  public:
    const long k;             // atoms
    const long padded_atoms;  // the atoms from k on are zeros
    long q = 0;               // coordinates of a row; those up to `row` are zeros
    long row = 0;
    double* planes;  // B (3 q, padded_atoms)

    // Room for reductions of atoms (k, 3, p).
    ReducedAtoms(Workspace& workspace, Tensor<const double> atoms);

    // Weigh the atoms with omega (p,) and take off the translation.
    void reduce(const double* omega, const Reduction& reduction);

    // Take the atoms as they are: q = p.
    void copy();

    // B_i (3, row). Few atoms of an image are ever used, so that a row is laid when it is asked for.
    const double* atom(long i) {
        double* B = rows_ + i * 3 * row;
        if (!laid_[i]) lay(i, B);
        return B;
    }

    // shape (3, row) = sum_i c_i B_i; returns ||c||_1.
    double mix(const ActiveSet& set, double* shape);

  private:
    void resize(long coordinates);
    void lay(long i, double* B);

    long p_;
    double* all_;   // B (3 p, padded_atoms), before the reduction
    double* rows_;  // B (k, 3, row)
    bool* laid_;
};

}  // namespace shapefit
