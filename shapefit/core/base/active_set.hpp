// One active-set method for every small quadratic program with signs:
//
//   min_x 1/2 x^T Q x - h^T x + lambda ||x||_1   over x >= 0, or over all x,
//
// and where `Terms::scaled` over x >= 0 with a^T x = 1. Q = V V^T is a Gram matrix that
// need not be regular, so that only used vectors, whose coefficient is not 0, are ever
// asked for.
//
// In the manner of Lawson and Hanson 1974, with signs as in Lee et al. 2007: minimise
// over the used coefficients with their signs held, dropping each that reaches 0 on the
// way, then use the one that `Terms` chooses too. A used vector that depends on those
// before it is exchanged: along sum_e d_e V_e = 0 the quadratic stays, and one
// coefficient reaches 0. So the used vectors are independent in the end, and no step
// raises the objective.
//
// `Terms` says what the program is, with sign = 1 or -1:
//
//   static constexpr bool scaled;                     whether a^T x = 1
//   double square(long i)                             Q_ii
//   void overlaps(long i, const long* used, long m, double* out)      Q_i,used_e for e
//   < m double pull(long i, double sign)                  h_i - lambda sign double
//   size(long i)                               a_i, where `scaled` bool choose(const
//   ActiveSet& set, long& next, double& sign)
//                                                     the best one that is not used;
//                                                     false for none
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
//   A vector v joins:  u = W^T Q_used,v,  pivot^2 = Q_vv - ||u||^2, the part of ||v||^2
//   outside the
//                      span of the others; the new column of W is (-W u, 1) / pivot.
//   One leaves:        Givens rotations of the columns gather its row of W in the last
//   column; both
//                      go, and what is left is triangular.
//
// A right side h goes along as y = W^T h.
class Cholesky {
  public:
    // For at most `capacity` vectors at a time.
    Cholesky(Workspace& workspace, long capacity)
        : stride_(padded(capacity + 1)),
          columns_(workspace.zeros<double>(capacity * stride_)),
          rows_(workspace.zeros<double>(capacity * stride_)),
          y_(workspace.zeros<double>(stride_)),
          u_(workspace.zeros<double>(stride_)) {}

    long size() const { return size_; }
    void clear() { size_ = 0; }

    // Let a vector join: `overlaps` Q_used,v, zeros after it up to padded(size + 1),
    // overwritten by
    // (-W u, 1), which is orthogonal to those in use; `square` Q_vv; `linear_term` h_v.
    // Where pivot^2 <= dependent * square or nan, it is lifted to that if `lifted`, and
    // else the factor stays as it was: then false is returned.
    bool append(double* overlaps, double square, double linear_term, double dependent,
                bool lifted) {
        double rest = square, rest_of_linear_term = linear_term;
        for (long e = 0; e < size_; ++e) {
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

    // Where the Gram matrix of many vectors stands from the diagonal on, before
    // `svd_and_prox`, with h_e in the place after the last of them.
    double* row(long e) { return rows_ + e * stride_; }

    // The first `count` vectors of all, as if they joined one after another; at the
    // first that is refused `minus_Wu` is as `append` leaves its overlaps.
    //
    // U row by row, less the products of the rows above, which are summed in registers.
    // `append` takes a sum across lanes for each of them.
    bool svd_and_prox(long count, double dependent, bool lifted, double* minus_Wu) {
        for (size_ = 0; size_ < count;) {
            double* __restrict current = row(size_);
            const double square = current[size_];
            for (long block = size_ / PADDING * PADDING; block <= count;
                 block += PADDING)
                subtract_rows_above(current, block);
            for (long e = 0; e < size_; ++e) u_[e] = -row(e)[size_];
            mix_rows(u_, size_, columns_, stride_, padded(size_), minus_Wu);
            double rest = current[size_];
            if (!(rest > dependent * square)) {
                minus_Wu[size_] = 1;
                if (!lifted) return false;
                rest = larger(dependent * square, TINY);
            }
            const double inverse = 1 / root(rest), rest_of_linear_term = current[count];
            for (long f = size_ + 1; f <= count; ++f) current[f] *= inverse;
            join(minus_Wu, inverse, rest_of_linear_term);
        }
        return true;
    }

    // Let the vector at place `at` leave; later ones move up.
    void remove(long at) {
        for (long e = at; e + 1 < size_; ++e) {
            turn_columns(e, at);
            double* one = column(e);
            for (long f = at; f <= e; ++f) one[f] = one[f + 1];
            one[e + 1] = 0;
        }
        --size_;
    }

    // out = Q^-1 h (padded).
    void solve(double* out) const {
        mix_rows(y_, size_, columns_, stride_, padded(size_), out);
    }

    // x <- Q^-1 x (padded).
    void solve_for(double* x) const {
        for (long e = size_; e < padded(size_); ++e) x[e] = 0;
        for (long e = 0; e < size_; ++e)
            u_[e] = dot_padded(column(e), x, padded(e + 1));
        mix_rows(u_, size_, columns_, stride_, padded(size_), x);
    }

  private:
    // The vector whose column of W is (minus_Wu, 1) * inverse.
    void join(const double* minus_Wu, double inverse, double rest_of_linear_term) {
        const long width = padded(size_);
        double* added = column(size_);
        for (long e = 0; e < PADDING; ++e) added[padded(size_ + 1) - PADDING + e] = 0;
        for (long e = 0; e < width; ++e) added[e] = inverse * minus_Wu[e];
        added[size_] = inverse;
        y_[size_++] = inverse * rest_of_linear_term;
    }

    // 8 columns of row `size_` of the Gram matrix, less the products of the rows of U
    // above.
    void subtract_rows_above(double* current, long block) {
        Doubles rest[PADDING / WIDTH];
        for (long l = 0; l < PADDING / WIDTH; ++l)
            rest[l] = load(current + block + l * WIDTH);
        for (long e = 0; e < size_; ++e) {
            const double factor = row(e)[size_];
            for (long l = 0; l < PADDING / WIDTH; ++l)
                rest[l] -= factor * load(row(e) + block + l * WIDTH);
        }
        for (long l = 0; l < PADDING / WIDTH; ++l)
            store(current + block + l * WIDTH, rest[l]);
    }

    double* column(long e) const { return columns_ + e * stride_; }

    // Turn columns e and e + 1 until row `at` of the first is 0.
    void turn_columns(long e, long at) {
        double* __restrict first = column(e);
        double* __restrict second = column(e + 1);
        const double a = first[at], b = second[at], inverse = 1 / root(a * a + b * b);
        const double sine = a * inverse, cosine = b * inverse;
        for (long f = 0; f < e + 2; ++f) {
            const double x = first[f], y = second[f];
            first[f] = sine * y - cosine * x;
            second[f] = sine * x + cosine * y;
        }
        const double x = y_[e], y = y_[e + 1];
        y_[e] = sine * y - cosine * x;
        y_[e + 1] = sine * x + cosine * y;
    }

    long size_ = 0, stride_;
    double* columns_;  // of W, one after another; column e has zeros after place e
    double* rows_;     // of U, where many vectors join at once
    double* y_;
    double* u_;
};

// The used coefficients x = x_e at places index_e, and room to work in.
struct ActiveSet {
    // For at most `capacity` coefficients that are not 0 at a time, those of the start
    // included.
    ActiveSet(Workspace& workspace, long capacity)
        : capacity(capacity),
          index(workspace.zeros<long>(capacity + 1)),
          x(workspace.zeros<double>(capacity + 1)),
          sign(workspace.zeros<double>(capacity + 1)),
          goal(workspace.zeros<double>(padded(capacity + 1))),
          column(workspace.zeros<double>(padded(capacity + 1))),
          factor(workspace, capacity + 1) {}

    void clear() {
        count = 0;
        factor.clear();
    }

    void use(long i, double value, double its_sign) {
        index[count] = i;
        x[count] = value;
        sign[count++] = its_sign;
    }

    // All coefficients c, those that are 0 among them.
    void write(Vector<double> c) const {
        for (long i = 0; i < c.size[0]; ++i) c[i] = 0;
        for (long e = 0; e < count; ++e) c[index[e]] = x[e];
    }

    void drop(long at) {
        if (at < factor.size()) factor.remove(at);
        --count;
        for (long e = at; e < count; ++e) {
            index[e] = index[e + 1];
            x[e] = x[e + 1];
            sign[e] = sign[e + 1];
        }
    }

    long count = 0, capacity;
    long* index;
    double *x, *sign, *goal, *column;
    Cholesky factor;        // of the first of them; the others wait
    double multiplier = 0;  // mu of a^T x = 1: h - Q x = mu a at the used ones
};

// How a minimisation ended: no coefficient is left to choose; the one chosen leaves at
// once, for it promises a gain by rounding only; the number of rounds ran out.
enum class Ending { OPTIMAL, ROUNDING, LIMIT };

// A used coefficient that reached 0 (none: -1), and the way that was gone until then.
struct Blocked {
    long at = -1;
    double length = 0;
};

// Take a step of up to `longest` along `direction` (count,), to the first coefficient
// that reaches 0.
inline Blocked step_along(ActiveSet& set, const double* direction, long count,
                          double longest) {
    Blocked blocked{-1, longest};
    for (long e = 0; e < count; ++e) {
        if ((set.x[e] + blocked.length * direction[e]) * set.sign[e] < 0)
            blocked = {e, -set.x[e] / direction[e]};
    }
    for (long e = 0; e < count; ++e) {
        set.x[e] += blocked.length * direction[e];
        if (set.x[e] * set.sign[e] < 0) set.x[e] = 0;  // by rounding
    }
    return blocked;
}

// Go towards the minimum over the used coefficients. All of them are in the factor.
template <class Terms>
Blocked improve(const Terms& terms, ActiveSet& set) {
    const long m = set.count;
    set.factor.solve(set.goal);
    if constexpr (Terms::scaled) {
        double excess = -1, unit = 0;
        for (long e = 0; e < m; ++e) set.column[e] = terms.size(set.index[e]);
        set.factor.solve_for(set.column);
        for (long e = 0; e < m; ++e) {
            excess += terms.size(set.index[e]) * set.goal[e];
            unit += terms.size(set.index[e]) * set.column[e];
        }
        set.multiplier = excess / unit;
        for (long e = 0; e < m; ++e) set.goal[e] -= set.multiplier * set.column[e];
    }
    double* direction = set.column;
    for (long e = 0; e < m; ++e) direction[e] = set.goal[e] - set.x[e];
    const Blocked blocked = step_along(set, direction, m, 1);
    if (blocked.at < 0)
        for (long e = 0; e < m; ++e) set.x[e] = set.goal[e];
    return blocked;
}

// The vector after those of the factor depends on them: go along sum_e d_e V_e = 0
// downhill. `set.column` is what the factor left: d = (-W u, 1).
template <class Terms>
Blocked exchange(const Terms& terms, ActiveSet& set) {
    const long last = set.factor.size();
    double* d = set.column;
    double fall = 0;
    for (long e = 0; e <= last; ++e)
        fall += d[e] * terms.linear_term(set.index[e], set.sign[e]);
    double way = fall < 0 ? -1 : 1;
    bool ends =
        false;  // where a coefficient reaches 0; rounding alone can hide the end
    for (long e = 0; e <= last; ++e) ends |= way * d[e] * set.sign[e] < 0;
    if (!ends) way = -way;
    for (long e = 0; e <= last; ++e) d[e] *= way;
    return step_along(set, d, last + 1, INFINITE);
}

constexpr long MANY = 8;  // vectors from which on they join together

// Bring all used vectors into the factor; false at the first that depends on those
// before it.
template <class Terms>
bool factorise(const Terms& terms, ActiveSet& set, double dependent) {
    if (set.factor.size() == 0 && set.count >= MANY) {
        for (long e = 0; e < set.count; ++e) {
            double* row = set.factor.row(e);
            terms.overlaps(set.index[e], set.index + e, set.count - e, row + e);
            row[set.count] = terms.linear_term(set.index[e], set.sign[e]);
        }
        return set.factor.svd_and_prox(set.count, dependent, Terms::scaled, set.column);
    }
    while (set.factor.size() < set.count) {
        const long m = set.factor.size(), i = set.index[m];
        double* tail = set.column + padded(m + 1) - PADDING;
        for (long e = 0; e < PADDING; ++e) tail[e] = 0;
        terms.overlaps(i, set.index, m, set.column);
        // Where the scale is fixed there is no way along which nothing changes: the
        // pivot is lifted.
        if (!set.factor.append(set.column, terms.square(i),
                               terms.linear_term(i, set.sign[m]), dependent,
                               Terms::scaled))
            return false;
    }
    return true;
}

// Minimise over the used coefficients, with fewer of them in the end where they change
// sign. `newest` says that the last one has just been chosen; returns whether that one
// left at once.
template <class Terms>
bool minimise_used(const Terms& terms, ActiveSet& set, double dependent, bool newest) {
    while (set.count > 0) {
        const bool regular = factorise(terms, set, dependent);
        const Blocked blocked = regular ? improve(terms, set) : exchange(terms, set);
        if (blocked.at < 0) return false;
        const bool rejected =
            newest && blocked.at == set.count - 1 && blocked.length == 0;
        newest = newest && blocked.at < set.count - 1;
        set.drop(blocked.at);
        if (rejected) return true;
    }
    return false;
}

constexpr long ROUNDS_BETWEEN_LOOKS = 16;  // most minimisations take fewer

// Minimise from the coefficients in the set on, each in use with its sign. `dependent`
// is the share of a vector's square outside the span of the others at which it depends
// on them.
template <class Terms>
Ending minimise(Terms& terms, ActiveSet& set, double dependent, long most_rounds) {
    set.factor.clear();
    bool newest = false;
    for (long round = 1; round <= most_rounds; ++round) {
        if (round % ROUNDS_BETWEEN_LOOKS == 0) check_interrupt();
        const bool rejected = minimise_used(terms, set, dependent, newest);
        long next = -1;
        double sign = 1;
        if (!terms.choose(set, next, sign)) return Ending::OPTIMAL;
        if (rejected || set.count == set.capacity) return Ending::ROUNDING;
        set.use(next, 0, sign);
        newest = true;
    }
    return Ending::LIMIT;
}

// Terms of the active-set method for a matrix Q given in full:
//
//   min_x 1/2 x^T Q x - h^T x   over x >= 0, and where `has_scale` a^T x = 1.
//
// The next coefficient is the one with the largest weight_i (h - Q x - mu a)_i beyond
// `least`.
template <bool has_scale>
struct DenseTerms {
    static constexpr bool scaled = has_scale;

    const double* Q;       // (k, k), symmetric
    const double* h;       // (k,)
    const double* a;       // (k,), where `has_scale`
    const double* weight;  // (k,)
    double least;
    double* score;  // (k,), room
    long k;

    double square(long i) const { return Q[i * k + i]; }
    double linear_term(long i, double) const { return h[i]; }
    double size(long i) const { return a[i]; }

    void overlaps(long i, const long* used, long m, double* out) const {
        for (long e = 0; e < m; ++e) out[e] = Q[i * k + used[e]];
    }

    bool choose(const ActiveSet& set, long& next, double&) {
        const double mu = set.multiplier;
        for (long i = 0; i < k; ++i) score[i] = has_scale ? h[i] - mu * a[i] : h[i];
        subtract_mixture(score, set.x, set.index, set.count, Q, k, k);
        for (long i = 0; i < k; ++i) score[i] *= weight[i];
        for (long e = 0; e < set.count; ++e) score[set.index[e]] = -INFINITE;
        const double best = largest_of(score, k);
        if (!(best > least)) return false;
        next = place_of(best, score, k);
        return true;
    }
};

}  // namespace shapefit
