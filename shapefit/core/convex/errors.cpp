#include "errors.hpp"

#include <string.h>

namespace shapefit {

SparseErrors::SparseErrors(Workspace& workspace, Index p)
    : p_(p),
      Y_(workspace.zeros<double>(2 * p)),
      D_(workspace.zeros<double>(2 * p)),
      fresh_(workspace.zeros<double>(2 * p)),
      rho_(workspace.zeros<double>(p)),
      curvature_(workspace.zeros<double>(2 * p)) {}

void SparseErrors::attach(const Reduction& reduction, const double* bounds, double* E) {
    reduction_ = &reduction;
    bounds_ = bounds;
    E_ = E;
    memset(fresh_, 0, sizeof(double) * 2 * p_);
    memset(D_, 0, sizeof(double) * 2 * p_);
    for (Index j = 0; j < p_; ++j) rho_[j] = 1;
}

void SparseErrors::begin(double threshold, const double* y, Index q) {
    threshold_ = threshold;
    for (Index m = 0; m < reduction_->visible_count; ++m) {
        const Index j = reduction_->visible[m];
        rho_[j] = threshold / bounds_[j];
    }
    for (int a = 0; a < 2; ++a) reduction_->expand(y + a * q, Y_ + a * p_, p_);
}

double SparseErrors::value(double step) const {
    double total = 0;
    for (int a = 0; a < 2; ++a)
        for (Index j = 0; j < p_; ++j) {
            const Index at = a * p_ + j;
            const double size = magnitude(E_[at] + rho_[j] * (Y_[at] + step * D_[at]));
            const double excess = larger(size - threshold_, 0);
            total += excess * excess / rho_[j];
        }
    return 0.5 * total;
}

ErrorsPoint SparseErrors::find(double* g, Index q) {
    ErrorsPoint point;
    for (int a = 0; a < 2; ++a) {
        double along = 0;
        for (Index m = 0; m < reduction_->visible_count; ++m) {
            const Index j = reduction_->visible[m], at = a * p_ + j;
            const double value = E_[at] + rho_[j] * Y_[at];
            const double excess = magnitude(value) - threshold_;
            fresh_[at] = excess > 0 ? sign_of(value) * excess : 0;
            along += fresh_[at] * reduction_->h[m];
            point.moved += square(fresh_[at] - E_[at]);
            point.share = larger(point.share, magnitude(Y_[at]) / bounds_[j]);
        }
        for (Index m = 0; m < q; ++m)
            g[a * q + m] +=
                fresh_[a * p_ + reduction_->visible[m]] - along * reduction_->h[m];
    }
    return point;
}

double SparseErrors::penalty(const double* g, Index q, bool quadratic) {
    if (!quadratic)
        for (int a = 0; a < 2; ++a) reduction_->expand(g + a * q, D_ + a * p_, p_);
    double total = 0;
    for (int a = 0; a < 2; ++a)
        for (Index j = 0; j < p_; ++j) {
            const Index at = a * p_ + j;
            total +=
                bounds_[j] * magnitude(quadratic ? fresh_[at] : fresh_[at] - D_[at]);
        }
    return total;
}

void SparseErrors::set_direction(const double* d, Index q) {
    for (int a = 0; a < 2; ++a) reduction_->expand(d + a * q, D_ + a * p_, p_);
}

void SparseErrors::step(double length) {
    for (Index e = 0; e < 2 * p_; ++e) Y_[e] += length * D_[e];
}

void SparseErrors::accept() { memcpy(E_, fresh_, sizeof(double) * 2 * p_); }

Index SparseErrors::count_curved() {
    Index count = 0;
    for (int a = 0; a < 2; ++a)
        for (Index m = 0; m < reduction_->visible_count; ++m) {
            const Index j = reduction_->visible[m];
            curvature_[a * p_ + m] = fresh_[a * p_ + j] != 0 ? rho_[j] : 0;
            count += fresh_[a * p_ + j] != 0;
        }
    return count;
}

void SparseErrors::append_rows(Index first, ShiftedGram& gram) const {
    const Index q = reduction_->coordinates();
    const double* h = reduction_->h.data;
    for (int a = 0; a < 2; ++a)
        for (Index m = 0; m <= q; ++m) {
            if (!(curvature_[a * p_ + m] > 0)) continue;
            const double size = root(curvature_[a * p_ + m]);
            double* row = gram.row(first++);
            for (Index j = 0; j <= gram.right_side(); ++j) row[j] = 0;
            for (Index j = 0; j < q; ++j) row[a * q + j] = -size * h[m] * h[j];
            if (m < q) row[a * q + m] += size;
        }
}

// For each axis a diagonal and a term of rank two.
void SparseErrors::write_matrix(double shift, double* C) const {
    const Index q = reduction_->coordinates(), n = 2 * q;
    const double* h = reduction_->h.data;
    memset(C, 0, sizeof(double) * n * n);
    for (int a = 0; a < 2; ++a) {
        const double* c = curvature_ + a * p_;
        double along = 0;
        for (Index m = 0; m <= q; ++m) along += c[m] * h[m] * h[m];
        for (Index i = 0; i < q; ++i) {
            double* row = C + (a * q + i) * n + a * q;
            for (Index j = 0; j < q; ++j) row[j] = h[i] * h[j] * (along - c[i] - c[j]);
            row[i] += shift + c[i];
        }
    }
}

}  // namespace shapefit
