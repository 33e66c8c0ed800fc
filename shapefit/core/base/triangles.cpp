#include "triangles.hpp"

#include "vectors.hpp"
#include "products.hpp"

namespace shapefit {
namespace {

// row -= share other, from the vector of column j on.
void subtract(double* __restrict row, double share, const double* other, long j, long end) {
    for (long c = j / PADDING * PADDING; c < end; ++c) row[c] -= share * other[c];
}

// U in the place of four rows, which have lost what the rows above take; false where S has no U.
bool factorise_rows(double* S, long i, long stride, double& log_det) {
    for (long r = i; r < i + TILE_ROWS; ++r) {
        double* row = S + r * stride;
        for (long m = i; m < r; ++m) subtract(row, S[m * stride + r], S + m * stride, r, stride);
        if (!(row[r] > TINY)) return false;
        const double pivot = root(row[r]), inverse = 1 / pivot;
        log_det += 2 * log(pivot);
        for (long c = r / PADDING * PADDING; c < stride; ++c) row[c] *= inverse;
        row[r] = pivot;
    }
    return true;
}

// V_r = (e_r - sum_(k < r) U_kr V_k) / U_rr for four rows, which have lost what the rows above take.
void invert_rows(const double* U, double* V, long i, long stride) {
    for (long r = i; r < i + TILE_ROWS; ++r) {
        double* row = V + r * stride;
        for (long m = i; m < r; ++m) subtract(row, U[m * stride + r], V + m * stride, 0, padded(r));
        const double inverse = 1 / U[r * stride + r];
        for (long c = 0; c < padded(r); ++c) row[c] *= inverse;
        row[r] = inverse;
    }
}

}  // namespace

double factorise_block(double* S, double* V, long n, long stride) {
    double log_det = 0;
    for (long i = 0; i < n; i += TILE_ROWS) {
        const long from = i / PADDING * PADDING;
        add_product(-1, transposed(S + i, stride), S + from, S + i * stride + from, TILE_ROWS,
                    stride - from, stride, stride, every(i));
        if (!factorise_rows(S, i, stride, log_det)) return NOT_A_NUMBER;
    }
    for (long e = 0; e < n * stride; ++e) V[e] = 0;
    for (long i = 0; i < n; i += TILE_ROWS) {
        add_product(-1, transposed(S + i, stride), V, V + i * stride, TILE_ROWS, padded(i), stride,
                    stride, from_column(i));
        invert_rows(S, V, i, stride);
    }
    return log_det;
}

void multiply_out(const double* V, double* C, long n, long stride) {
    for (long e = 0; e < n * stride; ++e) C[e] = 0;
    add_product(1, transposed(V, stride), V, C, n, stride, stride, stride, upper_from_column(n));
}

void mirror(double* C, long n, long stride) {
    for (long i = 0; i < n; ++i)
        for (long j = 0; j < i; ++j) C[i * stride + j] = C[j * stride + i];
}

}  // namespace shapefit
