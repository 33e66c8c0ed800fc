// Single steps of the convex kernel, for the tests that judge them one at a time.
#include "../base/registry.hpp"
#include "blocks.hpp"
#include "data.hpp"
#include "errors.hpp"

namespace shapefit {

// Single steps of the convex solver, for the tests that judge them one at a time.

// N (6, k) = Y B_i^T of Y (2, q) and atoms B (k, 3, q).
void correlate_part(Matrix<const double> Y, Tensor<const double> atoms, Matrix<double> N);
// max_i ||N_i||_* of N (6, k).
double nuclear_part(Matrix<const double> N);
// moreau of blocks.hpp for any k.
double moreau_part(const MoreauData& data);
// The derivative of prox_t at Q (6,): prox (6,), its rows F (6, 2 n + 1) over the atom B (3, n) with
// the right-hand side of `moved` (6,) in the last column, and W moved (6,). Returns their number.
long derivative_part(const DerivativeData& data);
// x of (C + F^T F) x = r + F^T f: C (n, n), or shift I where C is empty; F (rows, n), f (rows,).
void gram_part(const GramData& data);
// The curvature c (2, seen) of errors under weights omega (p,): its rows (2 seen, 2 q) and its
// matrix (2 q, 2 q).
void curvature_part(Vector<const double> omega, Matrix<const double> curvature,
                    Matrix<double> rows, Matrix<double> matrix);
// X (r, p) reduced to (r, q) and y (r, q) expanded to (r, p); returns the visible landmarks.
long reduce_part(Matrix<const double> X, Vector<const double> omega, Matrix<double> out);
long expand_part(Matrix<const double> y, Vector<const double> omega, Matrix<double> out);
// ||soft||^2 of the errors along a step, as SparseErrors::value takes it.
double soft_part(const SoftData& data);

namespace {

// Rows (r, k) with the width of whole vectors.
double* widen(Matrix<const double> rows, Workspace& workspace) {
    const long width = padded(rows.size[1]);
    double* wide = workspace.zeros<double>(rows.size[0] * width);
    for (long r = 0; r < rows.size[0]; ++r)
        for (long i = 0; i < rows.size[1]; ++i) wide[r * width + i] = rows[r][i];
    return wide;
}

}  // namespace

void correlate_part(Matrix<const double> Y, Tensor<const double> atoms, Matrix<double> N) {
    Workspace workspace;
    const Planes planes = find_planes(atoms, workspace);
    double* found = workspace.zeros<double>(6 * planes.padded_atoms);
    correlate(planes, Y[0].data, Y[1].data, found);
    for (long e = 0; e < 6; ++e)
        for (long i = 0; i < N.size[1]; ++i) N[e][i] = found[e * planes.padded_atoms + i];
}

double nuclear_part(Matrix<const double> N) {
    Workspace workspace;
    return largest_nuclear_norm(widen(N, workspace), padded(N.size[1]));
}

double moreau_part(const MoreauData& data) {
    const Vector<double> total = data.total;
    Workspace workspace;
    const long k = padded(total.size[0]);
    double* sums = workspace.zeros<double>(k);
    const double value =
        moreau(widen(data.M, workspace), widen(data.N, workspace), data.step,
               widen(data.dN, workspace), data.sigma, data.t, sums, k);
    for (long i = 0; i < total.size[0]; ++i) total[i] = sums[i];
    return value;
}

long derivative_part(const DerivativeData& data) {
    Workspace workspace;
    const long n = data.atom.size[1];
    const Planes planes = find_planes({data.atom.data, {1, 3, n}}, workspace);
    ReducedAtoms laid(workspace, planes, 1);
    laid.copy();
    ActiveBlocks active(workspace, PADDING);
    ShiftedGram gram(workspace, 6, 2 * n);
    double* M = workspace.zeros<double>(6 * PADDING);
    double* moved = workspace.zeros<double>(6 * PADDING);
    double* weighted = workspace.zeros<double>(6 * PADDING);
    double* total = workspace.zeros<double>(PADDING);
    total[0] = data.t + 1;
    for (int e = 0; e < 6; ++e) {
        M[e * PADDING] = data.argument[e];
        moved[e * PADDING] = data.moved[e];
    }
    active.find(M, M, 0, data.t, total, PADDING);
    active.weigh(data.t, data.resolvent ? Weighing::resolvent : Weighing::derivative);
    const long rows = active.write_rows(data.sigma, laid, moved, gram);
    active.apply_weights(moved, weighted);
    for (int e = 0; e < 6; ++e) {
        data.prox[e] = active.prox[e * PADDING];
        data.weighted[e] = weighted[e * PADDING];
    }
    for (long f = 0; f < rows; ++f) {
        for (long j = 0; j < 2 * n; ++j) data.rows[f][j] = gram.row(f)[j];
        data.rows[f][2 * n] = gram.row(f)[gram.right_side()];
    }
    return rows;
}

void gram_part(const GramData& data) {
    const Vector<double> x = data.x;
    Workspace workspace;
    const long rows = data.F.size[0], n = data.F.size[1];
    ShiftedGram gram(workspace, rows, n);
    for (long f = 0; f < rows; ++f) {
        for (long j = 0; j < n; ++j) gram.row(f)[j] = data.F[f][j];
        gram.row(f)[gram.right_side()] = data.f[f];
    }
    if (data.C.size[0] > 0)
        gram.solve(rows, data.C.data, data.r.data, x.data);
    else
        gram.solve(rows, data.shift, data.by_rows, data.r.data, x.data);
}

void curvature_part(Vector<const double> omega, Matrix<const double> curvature,
                    Matrix<double> rows, Matrix<double> matrix) {
    Workspace workspace;
    Reduction reduction(workspace, omega.size[0]);
    reduction.find(omega);
    const long n = matrix.size[0];
    ShiftedGram gram(workspace, rows.size[0], n);
    append_curved_rows(reduction, curvature.data, curvature.size[1], 0, gram);
    write_curved_matrix(reduction, curvature.data, curvature.size[1], 0, matrix.data);
    for (long f = 0; f < rows.size[0]; ++f)
        for (long j = 0; j < n; ++j) rows[f][j] = gram.row(f)[j];
}

long reduce_part(Matrix<const double> X, Vector<const double> omega, Matrix<double> out) {
    Workspace workspace;
    Reduction reduction(workspace, omega.size[0]);
    reduction.find(omega);
    for (long r = 0; r < out.size[0]; ++r) reduction.reduce(X[r].data, omega.data, out[r].data);
    return reduction.seen;
}

long expand_part(Matrix<const double> y, Vector<const double> omega, Matrix<double> out) {
    Workspace workspace;
    Reduction reduction(workspace, omega.size[0]);
    reduction.find(omega);
    for (long r = 0; r < out.size[0]; ++r)
        reduction.expand(y[r].data, out[r].data, omega.size[0]);
    return reduction.seen;
}

double soft_part(const SoftData& data) {
    return soft_squared(data.E.data, data.Y.data, data.step, data.D.data, data.rho.data,
                        data.threshold, data.rho.size[0]);
}

const Exported<correlate_part> correlate_exported{"correlate", PART};
const Exported<nuclear_part> largest_nuclear_norm_exported{"largest_nuclear_norm", PART};
const Exported<moreau_part> moreau_exported{"moreau", PART};
const Exported<derivative_part> derivative_exported{"derivative", PART};
const Exported<gram_part> solve_gram_exported{"solve_gram", PART};
const Exported<curvature_part> curvature_exported{"curvature", PART};
const Exported<reduce_part> reduce_exported{"reduce", PART};
const Exported<expand_part> expand_exported{"expand", PART};
const Exported<soft_part> soft_squared_exported{"soft_squared", PART};

}  // namespace shapefit
