#include "coefficient_step.hpp"

namespace shapefit {
namespace {

// By which an unused correlation may exceed lambda, as a share of it.
constexpr double SLACK = 1e-9;
// Share of an atom's square outside the span of the others.
constexpr double DEPENDENT = 1e-11;

}  // namespace

CoefficientStep::CoefficientStep(Workspace& workspace, ReducedAtoms& atoms, Index p)
    : set(workspace, atoms.k),
      atoms_(atoms),
      projected_(workspace.zeros<double>(atoms.k * 2 * padded(p))),
      along_(workspace.zeros<double>(atoms.k)),
      residual_(workspace.zeros<double>(2 * padded(p))),
      back_(workspace.zeros<double>(3 * p)),
      correlation_(workspace.zeros<double>(atoms.planes.padded_atoms)),
      magnitudes_(workspace.zeros<double>(atoms.planes.padded_atoms)) {}

void CoefficientStep::set_program(const double* w, double lam, bool is_signed) {
    w_ = w;
    lam_ = lam;
    is_signed_ = is_signed;
}

double CoefficientStep::minimise_at(const double* R) {
    R_ = R;
    for (Index e = 0; e < set.count; ++e) project(set.index[e]);
    minimise(*this, set, DEPENDENT, 10 * atoms_.k + 100);
    double objective = 0.5 * dot_padded(residual_, residual_, 2 * atoms_.row);
    for (Index e = 0; e < set.count; ++e) objective += lam_ * magnitude(set.x[e]);
    return objective;
}

double CoefficientStep::mix(double* shape) {
    const Index size = 3 * atoms_.row;
    double penalty = 0;
    for (Index j = 0; j < size; ++j) shape[j] = 0;
    for (Index e = 0; e < set.count; ++e) {
        penalty += magnitude(set.x[e]);
        add_to(shape, set.x[e], atoms_[set.index[e]], size);
    }
    return penalty;
}

void CoefficientStep::overlaps(Index i, const Index* used, Index m, double* out) const {
    const double* V = projected(i);
    for (Index e = 0; e < m; ++e)
        out[e] = dot_padded(V, projected(used[e]), 2 * atoms_.row);
}

bool CoefficientStep::choose(const ActiveSet&, Index& next, double& sign) {
    find_residual();
    correlate();
    for (Index e = 0; e < set.count; ++e) correlation_[set.index[e]] = 0;
    const Index k = atoms_.planes.padded_atoms;
    const double* score = correlation_;
    if (is_signed_) {
        for (Index i = 0; i < k; ++i) magnitudes_[i] = magnitude(correlation_[i]);
        score = magnitudes_;
    }
    const double best = largest_of(score, k);
    if (!(best > lam_ * (1 + SLACK))) return false;
    next = place_of(best, score, k);
    sign = correlation_[next] > 0 ? 1 : -1;
    project(next);
    return true;
}

// Store V_i = Rbar B_i, row after row, and h_i = <V_i, w>.
void CoefficientStep::project(Index i) {
    const Index row = atoms_.row;
    const double* B = atoms_[i];
    double* __restrict V = projected(i);
    const double *r = R_, *s = R_ + 3;
    for (Index j = 0; j < row; ++j) {
        const double x = B[j], y = B[row + j], z = B[2 * row + j];
        V[j] = r[0] * x + r[1] * y + r[2] * z;
        V[row + j] = s[0] * x + s[1] * y + s[2] * z;
    }
    along_[i] = dot_padded(V, w_, 2 * row);
}

// residual = w - sum_i c_i V_i, over the atoms in use.
void CoefficientStep::find_residual() {
    const Index size = 2 * atoms_.row;
    for (Index j = 0; j < size; ++j) residual_[j] = w_[j];
    subtract_mixture(residual_, set.x, set.index, set.count, projected_, size, size);
}

// correlation_i = <Rbar B_i, residual> = <B_i, Rbar^T residual> for all atoms.
void CoefficientStep::correlate() {
    const Index q = atoms_.q();
    const double *u = residual_, *v = residual_ + atoms_.row;
    for (int b = 0; b < 3; ++b) {
        const double x = R_[b], y = R_[3 + b];
        for (Index j = 0; j < q; ++j) back_[b * q + j] = x * u[j] + y * v[j];
    }
    find_inner_products(atoms_.planes, back_, correlation_);
}

}  // namespace shapefit
