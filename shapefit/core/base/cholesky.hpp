// W = U^-1 of the Cholesky factor U of a Gram matrix Q = U^T U whose vectors come and
// go: Q^-1 = W W^T.
#pragma once

#include "memory.hpp"
#include "vectors.hpp"

namespace shapefit {

// The inverse of a Cholesky factor that grows and shrinks with the list of vectors in
// use.
//
// Q = U^T U for the Gram matrix Q of the vectors V in use, U upper triangular, and W =
// U^-1 is what is kept: the vectors W^T V are orthonormal, as Gram and Schmidt make
// them. So that a solution Q^-1 h = W (W^T h) takes sums over rows alone and no
// substitution, whose steps would wait for one another.
//
// A vector v joins with u = W^T Q_used,v: pivot^2 = Q_vv - ||u||^2 is the part of
// ||v||^2 outside the span of the others, and the new column of W is (-W u, 1) / pivot.
//
// One leaves by Givens rotations of the columns, which gather its row of W in the last
// column; both go, and what is left is triangular.
//
// A right side h goes along as y = W^T h.
class Cholesky {
  public:
    // For at most `capacity` vectors at a time.
    Cholesky(Workspace& workspace, Index capacity)
        : stride_(padded(capacity + 1)),
          columns_(workspace.zeros<double>(capacity * stride_)),
          rows_(workspace.zeros<double>(capacity * stride_)),
          y_(workspace.zeros<double>(stride_)),
          u_(workspace.zeros<double>(stride_)) {}

    // The number of vectors in use.
    Index size() const { return size_; }
    // Remove all vectors.
    void clear() { size_ = 0; }

    // Let a vector v join: `overlaps` is Q_used,v, with zeros after it up to
    // padded(size + 1), and is overwritten by (-W u, 1); `square` is Q_vv,
    // `linear_term` h_v. Where pivot^2 <= dependent * square or nan, it is raised to
    // that if `lifted`; else false is returned, and the factor stays as it was.
    bool append(double* overlaps, double square, double linear_term, double dependent,
                bool lifted) {
        double rest = square, rest_of_linear_term = linear_term;
        for (Index e = 0; e < size_; ++e) {
            const double u = dot_padded(column(e), overlaps, padded(e + 1));
            rest -= u * u;
            rest_of_linear_term -= u * y_[e];
            u_[e] = -u;
        }
        mix_rows(u_, size_, columns_, stride_, padded(size_), overlaps);
        overlaps[size_] = 1;
        if (!(rest > dependent * square)) {
            if (!lifted) return false;
            rest = larger(dependent * square, TINY);
        }
        join(overlaps, 1 / root(rest), rest_of_linear_term);
        return true;
    }

    // Where the caller of `append_all` writes row e of the Gram matrix of all vectors,
    // from the diagonal on, and h_e after its last entry.
    double* row(Index e) { return rows_ + e * stride_; }

    // Let the first `count` vectors join one after another, by their Gram matrix in
    // `row`, in the place of all in use; false at the first that `append` would refuse,
    // where `minus_Wu` is as `append` leaves its overlaps.
    //
    // U row by row, less the products of the rows above, which are summed in registers.
    // `append` takes a sum across lanes for each of them.
    bool append_all(Index count, double dependent, bool lifted, double* minus_Wu) {
        for (size_ = 0; size_ < count;) {
            double* __restrict current = row(size_);
            const double square = current[size_];
            for (Index block = size_ / PADDING * PADDING; block <= count;
                 block += PADDING)
                subtract_rows_above(current, block);
            for (Index e = 0; e < size_; ++e) u_[e] = -row(e)[size_];
            mix_rows(u_, size_, columns_, stride_, padded(size_), minus_Wu);
            double rest = current[size_];
            if (!(rest > dependent * square)) {
                minus_Wu[size_] = 1;
                if (!lifted) return false;
                rest = larger(dependent * square, TINY);
            }
            const double inverse = 1 / root(rest), rest_of_linear_term = current[count];
            for (Index f = size_ + 1; f <= count; ++f) current[f] *= inverse;
            join(minus_Wu, inverse, rest_of_linear_term);
        }
        return true;
    }

    // Remove vector number `at`; later ones move up.
    void remove(Index at) {
        for (Index e = at; e + 1 < size_; ++e) {
            turn_columns(e, at);
            double* one = column(e);
            for (Index f = at; f <= e; ++f) one[f] = one[f + 1];
            one[e + 1] = 0;
        }
        --size_;
    }

    // out = Q^-1 h of the vectors in use (padded).
    void solve(double* out) const {
        mix_rows(y_, size_, columns_, stride_, padded(size_), out);
    }

    // x <- Q^-1 x for one number of each vector in use (padded).
    void solve_for(double* x) const {
        for (Index e = size_; e < padded(size_); ++e) x[e] = 0;
        for (Index e = 0; e < size_; ++e)
            u_[e] = dot_padded(column(e), x, padded(e + 1));
        mix_rows(u_, size_, columns_, stride_, padded(size_), x);
    }

  private:
    // Append (minus_Wu, 1) * inverse to the columns of W, and the entry of its vector
    // to y.
    void join(const double* minus_Wu, double inverse, double rest_of_linear_term) {
        const Index width = padded(size_);
        double* added = column(size_);
        for (Index e = 0; e < PADDING; ++e) added[padded(size_ + 1) - PADDING + e] = 0;
        for (Index e = 0; e < width; ++e) added[e] = inverse * minus_Wu[e];
        added[size_] = inverse;
        y_[size_++] = inverse * rest_of_linear_term;
    }

    // Subtract from 8 columns of row `size_` of the Gram matrix, from `block` on, the
    // products of the rows of U above.
    void subtract_rows_above(double* current, Index block) {
        Doubles rest[PADDING / WIDTH];
        for (Index l = 0; l < PADDING / WIDTH; ++l)
            rest[l] = load(current + block + l * WIDTH);
        for (Index e = 0; e < size_; ++e) {
            const double factor = row(e)[size_];
            for (Index l = 0; l < PADDING / WIDTH; ++l)
                rest[l] -= factor * load(row(e) + block + l * WIDTH);
        }
        for (Index l = 0; l < PADDING / WIDTH; ++l)
            store(current + block + l * WIDTH, rest[l]);
    }

    // Column e of W.
    double* column(Index e) const { return columns_ + e * stride_; }

    // Rotate columns e and e + 1 of W, and entries e and e + 1 of y with them, so that
    // row `at` of the first becomes 0 (Givens).
    void turn_columns(Index e, Index at) {
        double* __restrict first = column(e);
        double* __restrict second = column(e + 1);
        const double a = first[at], b = second[at], inverse = 1 / root(a * a + b * b);
        const double sine = a * inverse, cosine = b * inverse;
        for (Index f = 0; f < e + 2; ++f) {
            const double x = first[f], y = second[f];
            first[f] = sine * y - cosine * x;
            second[f] = sine * x + cosine * y;
        }
        const double x = y_[e], y = y_[e + 1];
        y_[e] = sine * y - cosine * x;
        y_[e + 1] = sine * x + cosine * y;
    }

    Index size_ = 0, stride_;
    double* columns_;  // of W, one after another; column e has zeros after place e
    double* rows_;     // of U, where many vectors join at once
    double* y_;
    double* u_;
};

}  // namespace shapefit
