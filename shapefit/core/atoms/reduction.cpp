#include "reduction.hpp"

#include "../base/scalar.hpp"

namespace shapefit {

void Reduction::find(Vector<const double> omega) {
    seen = 0;
    double total = 0;
    for (long j = 0; j < omega.size[0]; ++j) {
        if (!(omega[j] > 0)) continue;
        visible[seen] = j;
        h[seen] = omega[j];
        total += square(omega[j]);
        ++seen;
    }
    if (seen == 0) return;
    const double length = root(total);
    for (long m = 0; m < seen; ++m) h[m] /= length;
    h[seen - 1] += 1;
    // |u + e|^2 = 2 (1 + u_last), so h h^T = 2 v v^T / v^T v
    const double scale = 1 / root(h[seen - 1]);
    for (long m = 0; m < seen; ++m) h[m] *= scale;
}

void Reduction::reduce(const double* x, double anchor, const double* omega, double* out) const {
    double along = 0;
    for (long m = 0; m < seen; ++m)
        along += (x[visible[m]] - anchor) * omega[visible[m]] * h[m];
    for (long m = 0; m < seen - 1; ++m)
        out[m] = (x[visible[m]] - anchor) * omega[visible[m]] - along * h[m];
}

void Reduction::expand(const double* y, double* out, long p) const {
    double along = 0;
    for (long m = 0; m < seen - 1; ++m) along += y[m] * h[m];
    for (long j = 0; j < p; ++j) out[j] = 0;
    for (long m = 0; m < seen - 1; ++m) out[visible[m]] = y[m] - along * h[m];
    out[visible[seen - 1]] = -along * h[seen - 1];
}

}  // namespace shapefit
