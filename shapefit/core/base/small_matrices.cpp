#include "small_matrices.hpp"

#include "vectors.hpp"

namespace shapefit {
namespace {

constexpr Index LARGE = 256;  // rows from which on a factorisation takes long

// row_c -= share other_c for columns j <= c < end; some before j change too.
void subtract(double* __restrict row, double share, const double* other, Index j,
              Index end) {
    for (Index c = j / PADDING * PADDING; c < end; ++c) row[c] -= share * other[c];
}

// Overwrite rows i .. i + 3 of S, from which the products of the rows above have been
// subtracted, by rows of the Cholesky factor U, S = U^T U. Adds their part of log det
// S; false where S is not positive definite.
bool factorise_rows(double* S, Index i, Index stride, double& log_det) {
    double product = 1;
    for (Index r = i; r < i + TILE_ROWS; ++r) {
        double* row = S + r * stride;
        for (Index m = i; m < r; ++m)
            subtract(row, S[m * stride + r], S + m * stride, r, stride);
        if (!(row[r] > TINY)) return false;
        product *= row[r];
        const double pivot = root(row[r]), inverse = 1 / pivot;
        for (Index c = r / PADDING * PADDING; c < stride; ++c) row[c] *= inverse;
        row[r] = pivot;
    }
    log_det += log(product);
    return true;
}

// V_r = (e_r - sum_(k < r) U_kr V_k) / U_rr for rows i .. i + 3, which already hold
// -sum_(k < i) U_kr V_k.
void invert_rows(const double* U, double* V, Index i, Index stride) {
    for (Index r = i; r < i + TILE_ROWS; ++r) {
        double* row = V + r * stride;
        for (Index m = i; m < r; ++m)
            subtract(row, U[m * stride + r], V + m * stride, 0, padded(r));
        const double inverse = 1 / U[r * stride + r];
        for (Index c = 0; c < padded(r); ++c) row[c] *= inverse;
        row[r] = inverse;
    }
}

}  // namespace

double cholesky_inverse(double* S, double* V, Index n, Index stride) {
    double log_det = 0;
    for (Index i = 0; i < n; i += TILE_ROWS) {
        if (n >= LARGE) check_interrupt();
        const Index from = i / PADDING * PADDING;
        add_product(-1, transposed(S + i, stride), S + from, S + i * stride + from,
                    TILE_ROWS, stride - from, stride, stride, every(i));
        if (!factorise_rows(S, i, stride, log_det)) return NOT_A_NUMBER;
    }
    for (Index e = 0; e < n * stride; ++e) V[e] = 0;
    for (Index i = 0; i < n; i += TILE_ROWS) {
        if (n >= LARGE) check_interrupt();
        add_product(-1, transposed(S + i, stride), V, V + i * stride, TILE_ROWS,
                    padded(i), stride, stride, from_column(i));
        invert_rows(S, V, i, stride);
    }
    return log_det;
}

void multiply_out(const double* V, double* C, Index n, Index stride) {
    for (Index e = 0; e < n * stride; ++e) C[e] = 0;
    add_product(1, transposed(V, stride), V, C, n, stride, stride, stride,
                upper_from_column(n));
}

void mirror(double* C, Index n, Index stride) {
    for (Index i = 0; i < n; ++i)
        for (Index j = 0; j < i; ++j) C[i * stride + j] = C[j * stride + i];
}

namespace {

constexpr int MAX_SWEEPS = 30;
constexpr double ROUNDING = 0x1p-56;  // of an entry beside the norm of the matrix

// ||A||_F of a square A.
double norm(Matrix<const double> A) {
    double total = 0;
    for (Index e = 0; e < A.size[0] * A.size[1]; ++e) total += square(A.data[e]);
    return root(total);
}

// (x, y) <- (c x - s y, s x + c y) for two rows of `count` numbers.
void rotate_rows(double c, double s, double* __restrict x, double* __restrict y,
                 Index count) {
    for (Index e = 0; e < count; ++e) {
        const double before = x[e];
        x[e] = c * before - s * y[e];
        y[e] = s * before + c * y[e];
    }
}

// Rotate axes p and q of A, and rows p and q of V, so that A_pq becomes 0 (Jacobi).
void rotate(Matrix<double> A, Matrix<double> V, Index p, Index q) {
    const Index m = A.size[0];
    const double pp = A[p][p], qq = A[q][q], pq = A[p][q];
    const double ratio = (qq - pp) / (2 * pq);
    const double tangent =
        copysign(1.0, ratio) / (magnitude(ratio) + root(1 + square(ratio)));
    const double c = 1 / root(1 + square(tangent)), s = c * tangent;
    rotate_rows(c, s, A[p].data, A[q].data, m);
    rotate_rows(c, s, V[p].data, V[q].data, m);
    for (Index j = 0; j < m; ++j) {
        A[j][p] = A[p][j];
        A[j][q] = A[q][j];
    }
    A[p][p] = pp - tangent * pq;
    A[q][q] = qq + tangent * pq;
    A[p][q] = A[q][p] = 0;
}

// Sort the values in ascending order, and the rows of V with them.
void sort(Vector<double> values, Matrix<double> V) {
    const Index m = values.size[0];
    for (Index i = 0; i < m; ++i) {
        Index least = i;
        for (Index j = i + 1; j < m; ++j)
            if (values[j] < values[least]) least = j;
        if (least == i) continue;
        const double value = values[i];
        values[i] = values[least];
        values[least] = value;
        for (Index e = 0; e < m; ++e) {
            const double entry = V[i][e];
            V[i][e] = V[least][e];
            V[least][e] = entry;
        }
    }
}

}  // namespace

void symmetric_eigen(Matrix<double> A, Vector<double> values, Matrix<double> V) {
    const Index m = A.size[0];
    for (Index i = 0; i < m; ++i)
        for (Index j = 0; j < m; ++j) V[i][j] = i == j;
    const double negligible = ROUNDING * norm({A.data, {m, m}});
    for (int sweep = 0; sweep < MAX_SWEEPS; ++sweep) {
        bool converged = true;
        for (Index p = 0; p < m; ++p)
            for (Index q = p + 1; q < m; ++q)
                if (magnitude(A[p][q]) > negligible) {
                    rotate(A, V, p, q);
                    converged = false;
                }
        if (converged) break;
    }
    for (Index i = 0; i < m; ++i) values[i] = A[i][i];
    sort(values, V);
}

}  // namespace shapefit
