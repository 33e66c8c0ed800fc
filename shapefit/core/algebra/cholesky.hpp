// A Cholesky factor that grows and shrinks with the list of vectors in use.
//
// Q = U^T U for the Gram matrix Q of the vectors in use, with U upper triangular. A vector v joins at
// the end: U^T u = Q_used,v gives its column u, and the square of its pivot is the part of ||v||^2
// outside the span of the others, rest = Q_vv - ||u||^2. One that leaves takes its column with it;
// Givens rotations of the rows below make U triangular again.
#pragma once

#include "vectors.hpp"
#include "workspace.hpp"

namespace shapefit::SHAPEFIT_LEVEL {

class Cholesky {
  public:
    // For at most `room` vectors at a time.
    Cholesky(Workspace& workspace, long room)
        : stride_((room + 7) / 8 * 8 + 8),
          U_(workspace.zeros<double>((room + 1) * stride_)),
          inverse_(workspace.zeros<double>(room + 1)) {}

    long size() const { return size_; }
    void clear() { size_ = 0; }

    // Let a vector join: `overlaps` Q_used,v (size,), overwritten by its column u; `square` Q_vv.
    // Where rest <= dependent * square or nan, it is lifted to that if `lifted`, and else the factor
    // stays as it was: then false is returned.
    bool append(double* overlaps, double square, double dependent, bool lifted = false) {
        for (long e = 0; e < size_; ++e) {
            const double* row = U_ + e * stride_;
            overlaps[e] *= inverse_[e];
            for (long f = e + 1; f < size_; ++f) overlaps[f] -= overlaps[e] * row[f];
        }
        double rest = square - dot(overlaps, overlaps, size_);
        if (!(rest > dependent * square)) {
            if (!lifted) return false;
            rest = larger(dependent * square, TINY);
        }
        for (long e = 0; e < size_; ++e) U_[e * stride_ + size_] = overlaps[e];
        const double pivot = root(rest);
        U_[size_ * stride_ + size_] = pivot;
        inverse_[size_++] = 1 / pivot;
        return true;
    }

    // Let the vector at place `at` leave; later ones move up.
    void remove(long at) {
        for (long e = 0; e < at; ++e) {
            double* row = U_ + e * stride_;
            for (long f = at; f + 1 < size_; ++f) row[f] = row[f + 1];
        }
        for (long e = at; e + 1 < size_; ++e) turn_rows(e);
        --size_;
    }

    // x <- U^-T x.
    void solve_transposed(double* x) const {
        for (long e = 0; e < size_; ++e) {
            const double* row = U_ + e * stride_;
            x[e] *= inverse_[e];
            for (long f = e + 1; f < size_; ++f) x[f] -= x[e] * row[f];
        }
    }

    // x <- U^-1 x.
    void solve_upper(double* x) const {
        for (long e = size_ - 1; e >= 0; --e) {
            const double* row = U_ + e * stride_;
            x[e] = (x[e] - dot(row + e + 1, x + e + 1, size_ - e - 1)) * inverse_[e];
        }
    }

    // x <- Q^-1 x.
    void solve(double* x) const {
        solve_transposed(x);
        solve_upper(x);
    }

  private:
    // Row e ends one column to the left, without the entry of row e + 1 below it.
    void turn_rows(long e) {
        double* __restrict upper = U_ + e * stride_;
        double* __restrict lower = U_ + (e + 1) * stride_;
        const double a = upper[e + 1], b = lower[e + 1];
        const double inverse = 1 / root(a * a + b * b);
        const double cosine = a * inverse, sine = b * inverse;
        for (long f = e; f + 1 < size_; ++f) {
            const double u = upper[f + 1], v = lower[f + 1];
            upper[f] = cosine * u + sine * v;
            lower[f + 1] = cosine * v - sine * u;
        }
        inverse_[e] = inverse;
    }

    long size_ = 0, stride_;
    double* U_;        // row after row; below the diagonal and beyond `size` anything
    double* inverse_;  // of the pivots
};

}  // namespace shapefit::SHAPEFIT_LEVEL
