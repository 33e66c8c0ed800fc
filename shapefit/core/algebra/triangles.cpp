#include "triangles.hpp"

#include "vectors.hpp"
#include "products.hpp"

namespace shapefit::SHAPEFIT_LEVEL {

double factorise_block(double* S, double* V, long n, long stride) {
    double log_det = 0;
    for (long i = 0; i < n; ++i) {
        double* __restrict row = S + i * stride;
        if (!(row[i] > TINY)) return NOT_A_NUMBER;
        const double pivot = root(row[i]), inverse = 1 / pivot;
        log_det += 2 * log(pivot);
        const long from = i / PADDING * PADDING;
        for (long j = from; j < stride; ++j) row[j] *= inverse;
        row[i] = pivot;
        for (long r = i + 1; r < n; ++r) {
            double* __restrict other = S + r * stride;
            const double share = row[r];
            for (long j = r / PADDING * PADDING; j < stride; ++j) other[j] -= share * row[j];
        }
    }
    for (long i = 0; i < n; ++i) {
        double* __restrict row = V + i * stride;
        const double inverse = 1 / S[i * stride + i];
        const long width = padded(i + 1);
        for (long j = 0; j < stride; ++j) row[j] = 0;
        for (long k = 0; k < i; ++k) {
            const double share = -S[k * stride + i];
            const double* other = V + k * stride;
            for (long j = 0; j < width; ++j) row[j] += share * other[j];
        }
        for (long j = 0; j < width; ++j) row[j] *= inverse;
        row[i] = inverse;
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

}  // namespace shapefit::SHAPEFIT_LEVEL
