#include "objective.hpp"

#include "../base/registry.hpp"
#include "../pose/rotations.hpp"

namespace shapefit {
namespace {

bool same(const double* x, const double* y, long n) {
    for (long i = 0; i < n; ++i)
        if (x[i] != y[i]) return false;
    return true;
}

double largest_norm(const ReducedAtoms& atoms) {
    double largest = 0;
    for (long i = 0; i < atoms.k; ++i) {
        double total = 0;
        for (long j = 0; j < 3 * atoms.q; ++j) total += square(atoms.planes[j * atoms.padded_atoms + i]);
        largest = larger(total, largest);
    }
    return root(largest);
}

}  // namespace

RotationObjective::RotationObjective(Workspace& workspace, const SearchProblem& problem)
    : problem(problem),
      atoms(workspace, problem.atoms),
      reduction(workspace, problem.atoms.size[2]),
      w(workspace.zeros<double>(2 * padded(problem.atoms.size[2]))),
      step_(workspace, atoms, problem.atoms.size[2]),
      shape_(workspace.zeros<double>(3 * padded(problem.atoms.size[2]))) {}

bool RotationObjective::aim(long image) {
    const Vector<const double> omega = problem.weights[image];
    const long p = omega.size[0];
    if (image_ < 0 || !same(omega.data, problem.weights[image_].data, p)) {
        reduction.find(omega);
        atoms.reduce(omega.data, reduction);
        largest = largest_norm(atoms);
        for (long j = 0; j < 2 * atoms.row; ++j) w[j] = 0;
    }
    image_ = image;
    if (reduction.seen < 2) return false;
    reduction.reduce_landmarks(problem.landmarks[image], omega.data, w, atoms.row);
    square = dot_padded(w, w, 2 * atoms.row);
    lam = problem.lam[image];
    step_.aim(w, lam, problem.is_signed);
    step_.set.clear();
    return true;
}

double RotationObjective::value(const double* R) {
    for (int e = 0; e < 9; ++e) R_[e] = R[e];
    return step_.minimise_at(R_);
}

// With X = R S and y = (Y, 0): d/dturn of <-Y, turn x X> is -sum_j X_j x y_j.
void RotationObjective::derivatives(double* gradient, double* curvature) {
    atoms.mix(step_.set, shape_);
    const long row = atoms.row;
    const double *u = step_.residual(), *v = u + row;
    double P[9], turned[9], moment[6];
    for (int b = 0; b < 3; ++b) {
        const double* S = shape_ + b * row;
        for (int a = 0; a <= b; ++a) P[3 * a + b] = P[3 * b + a] = dot_padded(S, shape_ + a * row, row);
        moment[b] = dot_padded(S, u, row);      // S u^T
        moment[3 + b] = dot_padded(S, v, row);  // S v^T
    }
    // X X^T = R P R^T, X u^T = R (S u^T)
    double XX[9], Xu[3], Xv[3];
    for (int a = 0; a < 3; ++a) {
        for (int b = 0; b < 3; ++b) turned[3 * a + b] = inner3(R_ + 3 * a, P + 3 * b);
        Xu[a] = inner3(R_ + 3 * a, moment);
        Xv[a] = inner3(R_ + 3 * a, moment + 3);
    }
    for (int a = 0; a < 3; ++a)
        for (int b = 0; b < 3; ++b) XX[3 * a + b] = inner3(turned + 3 * a, R_ + 3 * b);
    gradient[0] = Xv[2];
    gradient[1] = -Xu[2];
    gradient[2] = Xu[1] - Xv[0];
    // the rows of the derivative of the projection are (0, z, -y) and (-z, 0, x)
    curvature[0] = XX[8];
    curvature[4] = XX[8];
    curvature[8] = XX[0] + XX[4];
    curvature[1] = curvature[3] = 0;
    curvature[2] = curvature[6] = -XX[2];
    curvature[5] = curvature[7] = -XX[5];
}

void RotationObjective::write_coefficients(Vector<double> c) const {
    for (long i = 0; i < c.size[0]; ++i) c[i] = 0;
    for (long e = 0; e < step_.set.count; ++e) c[step_.set.index[e]] = step_.set.x[e];
}

void find_coefficients(const CoefficientsData& data, Range range) {
    Workspace workspace;
    RotationObjective objective(workspace, data.problem);
    for (long image = range.first; image < range.last; ++image) {
        if (!objective.aim(image)) continue;
        data.objective[image] = objective.value(data.rotation[image].data);
        objective.write_coefficients(data.coefficients[image]);
    }
}

const Exported<find_coefficients> find_coefficients_exported{"find_coefficients"};

}  // namespace shapefit
