#include "reduced_atoms.hpp"

namespace shapefit {

ReducedAtoms::ReducedAtoms(Workspace& workspace, Tensor<const double> atoms)
    : k(atoms.size[0]),
      padded_atoms(padded(k)),
      planes(workspace.zeros<double>(3 * atoms.size[2] * padded_atoms)),
      p_(atoms.size[2]),
      all_(workspace.zeros<double>(3 * p_ * padded_atoms)),
      rows_(workspace.zeros<double>(k * 3 * padded(p_))),
      laid_(workspace.zeros<bool>(k)) {
    for (long i = 0; i < k; ++i)
        for (long r = 0; r < 3 * p_; ++r) all_[r * padded_atoms + i] = atoms[i].data[r];
}

void ReducedAtoms::reduce(const double* omega, const Reduction& reduction) {
    resize(reduction.coordinates());
    for (int b = 0; b < 3; ++b)
        for (long i = 0; i < padded_atoms; i += WIDTH) {
            const double* from = all_ + b * p_ * padded_atoms + i;
            double* to = planes + b * q * padded_atoms + i;
            Doubles along = {};
            for (long m = 0; m < reduction.seen; ++m) {
                const long j = reduction.visible[m];
                along += (omega[j] * reduction.h[m]) * load(from + j * padded_atoms);
            }
            for (long m = 0; m < q; ++m) {
                const long j = reduction.visible[m];
                store(to + m * padded_atoms,
                      omega[j] * load(from + j * padded_atoms) - reduction.h[m] * along);
            }
        }
}

void ReducedAtoms::copy() {
    resize(p_);
    for (long e = 0; e < 3 * p_ * padded_atoms; ++e) planes[e] = all_[e];
}

double ReducedAtoms::mix(const ActiveSet& set, double* shape) {
    const long size = 3 * padded(q);
    double penalty = 0;
    for (long j = 0; j < size; ++j) shape[j] = 0;
    for (long e = 0; e < set.count; ++e) {
        penalty += magnitude(set.x[e]);
        const double* B = atom(set.index[e]);
        for (long j = 0; j < size; ++j) shape[j] += set.x[e] * B[j];
    }
    return penalty;
}

void ReducedAtoms::resize(long coordinates) {
    q = coordinates;
    row = padded(q);
    for (long i = 0; i < k; ++i) laid_[i] = false;
}

void ReducedAtoms::lay(long i, double* B) {
    for (int b = 0; b < 3; ++b)
        for (long j = 0; j < row; ++j)
            B[b * row + j] = j < q ? planes[(b * q + j) * padded_atoms + i] : 0;
    laid_[i] = true;
}

}  // namespace shapefit
