// Single steps of the convex solver, for the tests that judge them one at a time.
#include "../base/registry.hpp"
#include "newton.hpp"

namespace shapefit {
namespace {

// Rows (r, k) with the width of whole vectors.
double* widen(Matrix<const double> rows, Workspace& workspace) {
    const long width = padded(rows.size[1]);
    double* wide = workspace.zeros<double>(rows.size[0] * width);
    for (long r = 0; r < rows.size[0]; ++r)
        for (long i = 0; i < rows.size[1]; ++i) wide[r * width + i] = rows[r][i];
    return wide;
}

// moreau of blocks.hpp for any k.
double moreau_part(Matrix<const double> M, Matrix<const double> N, double step,
                   Matrix<const double> dN, double sigma, double t, Vector<double> total) {
    Workspace workspace;
    const long k = padded(total.size[0]);
    double* sums = workspace.zeros<double>(k);
    const double value = moreau(widen(M, workspace), widen(N, workspace), step, widen(dN, workspace),
                                sigma, t, sums, k);
    for (long i = 0; i < total.size[0]; ++i) total[i] = sums[i];
    return value;
}

// The derivative of prox_t at Q (6,): prox (6,), its rows F (6, 2 n + 1) over the atom B (3, n) with
// the right-hand side of X (6,) in the last column, and W X (6,). Returns their number.
long derivative_part(Vector<const double> Q, double t, double sigma, bool resolvent,
                     Matrix<const double> B, Vector<const double> X, Vector<double> prox,
                     Vector<double> weighted, Matrix<double> F) {
    Workspace workspace;
    const long n = B.size[1];
    ReducedAtoms atoms(workspace, find_planes({B.data, {1, 3, n}}, workspace), 1);
    atoms.copy();
    ActiveBlocks active(workspace, PADDING);
    ShiftedGram gram(workspace, 6, 2 * n);
    double *M = workspace.zeros<double>(6 * PADDING), *moved = workspace.zeros<double>(6 * PADDING);
    double *W = workspace.zeros<double>(6 * PADDING), *total = workspace.zeros<double>(PADDING);
    total[0] = t + 1;
    for (int e = 0; e < 6; ++e) {
        M[e * PADDING] = Q[e];
        moved[e * PADDING] = X[e];
    }
    active.find(M, M, 0, t, total, PADDING);
    active.weigh(t, resolvent ? Weighing::resolvent : Weighing::derivative);
    const long rows = active.write_rows(sigma, atoms, moved, gram);
    active.apply_weights(moved, W);
    for (int e = 0; e < 6; ++e) {
        prox[e] = active.prox[e * PADDING];
        weighted[e] = W[e * PADDING];
    }
    for (long f = 0; f < rows; ++f) {
        for (long j = 0; j < 2 * n; ++j) F[f][j] = gram.row(f)[j];
        F[f][2 * n] = gram.row(f)[gram.right_side()];
    }
    return rows;
}

// x of (C + F^T F) x = r + F^T f: C (n, n), or shift I where C is empty; F (rows, n), f (rows,).
void gram_part(Matrix<const double> F, Vector<const double> f, Vector<const double> r,
               Matrix<const double> C, double shift, bool by_rows, Vector<double> x) {
    Workspace workspace;
    const long rows = F.size[0], n = F.size[1];
    ShiftedGram gram(workspace, rows, n);
    for (long e = 0; e < rows; ++e) {
        for (long j = 0; j < n; ++j) gram.row(e)[j] = F[e][j];
        gram.row(e)[gram.right_side()] = f[e];
    }
    if (C.size[0] > 0)
        gram.solve(rows, C.data, r.data, x.data);
    else
        gram.solve(rows, shift, by_rows, r.data, x.data);
}

const Exported<moreau_part> moreau_exported{"moreau", PART};
const Exported<derivative_part> derivative_exported{"derivative", PART};
const Exported<gram_part> solve_gram_exported{"solve_gram", PART};

}  // namespace
}  // namespace shapefit
