#include "certificate.hpp"

#include "../base/registry.hpp"
#include "newton.hpp"

namespace shapefit {
namespace {

struct Sums {
    double primal = 0, residual = 0, scale = 0;
};

// `centred` and `left` become W less its mean, weighted by omega^2; returns omega . omega.
double centre(Matrix<const double> W, Vector<const double> omega, Certifier& room, double* mean) {
    const long p = omega.size[0];
    double total = 0;
    long first = -1;
    for (long j = 0; j < p; ++j) {
        total += square(omega[j]);
        if (omega[j] > 0 && first < 0) first = j;
    }
    for (int a = 0; a < 2; ++a) {
        const double anchor = W[a][first];  // taken off first: landmarks on one point give exact 0
        mean[a] = 0;
        for (long j = 0; j < p; ++j)
            if (omega[j] > 0) mean[a] += square(omega[j]) * (W[a][j] - anchor) / total;
        for (long j = 0; j < p; ++j) {
            const double value = omega[j] > 0 ? W[a][j] - anchor - mean[a] : 0;
            room.centred[a][j] = value;
            room.left[a][j] = value;
        }
        mean[a] += anchor;
    }
    return total;
}

// left -= sum M_i B_i; returns sum ||M_i||_2.
double subtract_shapes(const ImageTransforms& M, Tensor<const double> B, Matrix<double> left) {
    const long p = B.size[2];
    double norms = 0;
    for (long e = 0; e < M.count; ++e) {
        const double* m = M.blocks + 6 * e;
        const double q[6] = {m[0], m[1], m[2], m[3], m[4], m[5]};
        subtract_shape(q, B[M.atom[e]].data, p, left.data, p);
        norms += spectral_norm(invariants(q));
    }
    return norms;
}

// The translation of one axis beside the mean: the mean of what M and, if any, E leave.
double find_shift(Vector<const double> omega, const double* left, const double* E, bool quadratic) {
    double shift = 0, total = 0;
    for (long j = 0; j < omega.size[0]; ++j) {
        if (!(omega[j] > 0)) continue;
        const double weight = quadratic ? square(omega[j]) : 1;
        shift += weight * (E ? left[j] - E[j] / omega[j] : left[j]);
        total += weight;
    }
    return shift / total;
}

// The loss of one axis, its errors, and Y made orthogonal to omega.
void add_axis(const ConvexProgram& program, Vector<const double> omega, double total, double shift,
              const double* centred, const double* left, double* E, double* Y, Sums& sums) {
    const bool robust = program.bound < INFINITE, quadratic = program.delta > 0;
    const double bound = program.bound;
    double along = 0;
    for (long j = 0; j < omega.size[0]; ++j) {
        const double r = omega[j] * (left[j] - shift), size = magnitude(r);
        sums.residual += r * r;
        sums.scale += square(omega[j] * centred[j]);
        const double excess = larger(size - bound, 0);
        if (robust) E[j] = quadratic ? sign_of(r) * excess : r;
        if (quadratic)
            sums.primal += robust && excess > 0 ? bound * (size - 0.5 * bound) : 0.5 * r * r;
        else if (robust)
            sums.primal += bound * size;
        along += Y[j] * omega[j] / total;
    }
    for (long j = 0; j < omega.size[0]; ++j) Y[j] = omega[j] > 0 ? Y[j] - along * omega[j] : 0;
}

// Scale Y until it is feasible; returns D.
double find_bound(const ConvexProgram& program, Vector<const double> omega, double lam,
                  Certifier& room, Matrix<double> Y) {
    const long p = omega.size[0];
    double yy = 0, yw = 0, entry = 0;
    for (int a = 0; a < 2; ++a)
        for (long j = 0; j < p; ++j) {
            room.weighted[a][j] = Y[a][j] * omega[j];
            yy += square(Y[a][j]);
            yw += room.weighted[a][j] * room.centred[a][j];
            entry = larger(entry, magnitude(Y[a][j]));
        }
    correlate(room.planes, room.weighted[0].data, room.weighted[1].data, room.N);
    const double largest = largest_nuclear_norm(room.N, room.planes.padded_atoms);
    const DualBound bound(lam, program.delta, largest, entry / program.bound, yy, yw);
    for (long e = 0; e < 2 * p; ++e) Y.data[e] *= bound.scale;
    return bound.value;
}

}  // namespace

Certifier::Certifier(const ConvexProgram& data, Workspace& workspace)
    : program(data),
      planes(find_planes(data.atoms, workspace)),
      centred(workspace.matrix<double>(2, data.atoms.size[2])),
      left(workspace.matrix<double>(2, data.atoms.size[2])),
      weighted(workspace.matrix<double>(2, data.atoms.size[2])),
      N(workspace.zeros<double>(6 * planes.padded_atoms)) {}

void Certifier::certify(long image, const ImageTransforms& M, const ConvexPoint& point,
                        const ConvexProof& proof) {
    const Vector<const double> omega = program.weights[image];
    double mean[2];
    const double total = centre(program.landmarks[image], omega, *this, mean);
    const double norms = subtract_shapes(M, program.atoms, left);
    Sums sums;
    sums.primal = program.lam[image] * norms;
    for (int a = 0; a < 2; ++a) {
        double *E = point.errors[image][a].data, *Y = point.dual[image][a].data;
        const bool quadratic = program.delta > 0, squared = quadratic && !(program.bound < INFINITE);
        const double shift = find_shift(omega, left[a].data, squared ? nullptr : E, quadratic);
        point.translation[image][a] = mean[a] + shift;
        add_axis(program, omega, total, shift, centred[a].data, left[a].data, E, Y, sums);
    }
    const double dual = find_bound(program, omega, program.lam[image], *this, point.dual[image]);
    proof.objective[image] = sums.primal;
    proof.relative_gap[image] = sums.primal == 0 ? 0 : (sums.primal - dual) / sums.primal;
    proof.residual[image] = sums.scale > 0 ? root(sums.residual / sums.scale) : 0;
}

void certify_images(const CertificateTask& task, Range range) {
    Workspace workspace;
    Certifier certifier(task.program, workspace);
    for (long image = range.first; image < range.last; ++image)
        certifier.certify(image, task.transforms[image], task.point, task.proof);
}

const Exported<certify_images> certify_exported{"certify"};

}  // namespace shapefit
