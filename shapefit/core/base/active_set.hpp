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
//   static constexpr bool scaled;
//       whether a^T x = 1
//   double square(Index i)
//       Q_ii
//   void overlaps(Index i, const Index* used, Index m, double* out)
//       out_e = Q_i,used_e for e < m
//   double linear_term(Index i, double sign)
//       h_i - lambda sign
//   double size(Index i)
//       a_i, where `scaled`
//   bool choose(const ActiveSet& set, Index& next, double& sign)
//       the best one that is not used; false for none
#pragma once

#include "cholesky.hpp"

namespace shapefit {

// The used coefficients: number e is x_e, the coefficient index_e of the program, with
// its sign_e.
struct ActiveSet {
    // For at most `capacity` used coefficients at a time.
    ActiveSet(Workspace& workspace, Index capacity)
        : capacity(capacity),
          index(workspace.zeros<Index>(capacity + 1)),
          x(workspace.zeros<double>(capacity + 1)),
          sign(workspace.zeros<double>(capacity + 1)),
          goal(workspace.zeros<double>(padded(capacity + 1))),
          column(workspace.zeros<double>(padded(capacity + 1))),
          factor(workspace, capacity + 1) {}

    // Use no coefficient.
    void clear() {
        count = 0;
        factor.clear();
    }

    // Add coefficient i, with this value and sign, to those in use; its vector joins
    // the factor later.
    void use(Index i, double value, double its_sign) {
        index[count] = i;
        x[count] = value;
        sign[count++] = its_sign;
    }

    // Write all coefficients c (k,): 0 for those that are not in use.
    void write(Vector<double> c) const {
        for (Index i = 0; i < c.size[0]; ++i) c[i] = 0;
        for (Index e = 0; e < count; ++e) c[index[e]] = x[e];
    }

    // Remove the used coefficient number `at`, and its vector from the factor.
    void drop(Index at) {
        if (at < factor.size()) factor.remove(at);
        --count;
        for (Index e = at; e < count; ++e) {
            index[e] = index[e + 1];
            x[e] = x[e + 1];
            sign[e] = sign[e + 1];
        }
    }

    Index count = 0, capacity;
    Index* index;
    double *x, *sign;
    double *goal, *column;  // scratch: the minimum over the used ones, and a right side
    Cholesky factor;        // of the vectors of the first ones; the others join later
    double multiplier = 0;  // mu of a^T x = 1: h - Q x = mu a at the used ones
};

// How a minimisation ended: no coefficient is left to choose; the one chosen leaves at
// once, for it promises a gain by rounding only; the number of rounds ran out.
enum class Ending { OPTIMAL, ROUNDING, LIMIT };

// How a step ended: the used coefficient that reached 0 (none: -1), and the length of
// the step, as a multiple of its direction.
struct Blocked {
    Index at = -1;
    double length = 0;
};

// x += length * direction (count,), for the largest length <= longest at which no used
// coefficient changes its sign; returns it, with the coefficient that reached 0.
inline Blocked step_along(ActiveSet& set, const double* direction, Index count,
                          double longest) {
    Blocked blocked{-1, longest};
    for (Index e = 0; e < count; ++e) {
        if ((set.x[e] + blocked.length * direction[e]) * set.sign[e] < 0)
            blocked = {e, -set.x[e] / direction[e]};
    }
    for (Index e = 0; e < count; ++e) {
        set.x[e] += blocked.length * direction[e];
        if (set.x[e] * set.sign[e] < 0) set.x[e] = 0;  // by rounding
    }
    return blocked;
}

// Step towards the minimum over the used coefficients, whose vectors are all in the
// factor, until it or a coefficient of 0 is reached.
template <class Terms>
Blocked improve(const Terms& terms, ActiveSet& set) {
    const Index m = set.count;
    set.factor.solve(set.goal);
    if constexpr (Terms::scaled) {
        double excess = -1, unit = 0;
        for (Index e = 0; e < m; ++e) set.column[e] = terms.size(set.index[e]);
        set.factor.solve_for(set.column);
        for (Index e = 0; e < m; ++e) {
            excess += terms.size(set.index[e]) * set.goal[e];
            unit += terms.size(set.index[e]) * set.column[e];
        }
        set.multiplier = excess / unit;
        for (Index e = 0; e < m; ++e) set.goal[e] -= set.multiplier * set.column[e];
    }
    double* direction = set.column;
    for (Index e = 0; e < m; ++e) direction[e] = set.goal[e] - set.x[e];
    const Blocked blocked = step_along(set, direction, m, 1);
    if (blocked.at < 0)
        for (Index e = 0; e < m; ++e) set.x[e] = set.goal[e];
    return blocked;
}

// Step downhill along d with sum_e d_e V_e = 0 until a coefficient reaches 0, where the
// vector after those of the factor depends on them. `set.column` is d = (-W u, 1), as
// the factor left it.
template <class Terms>
Blocked exchange(const Terms& terms, ActiveSet& set) {
    const Index last = set.factor.size();
    double* d = set.column;
    double fall = 0;
    for (Index e = 0; e <= last; ++e)
        fall += d[e] * terms.linear_term(set.index[e], set.sign[e]);
    double way = fall < 0 ? -1 : 1;
    bool ends =
        false;  // where a coefficient reaches 0; rounding alone can hide the end
    for (Index e = 0; e <= last; ++e) ends |= way * d[e] * set.sign[e] < 0;
    if (!ends) way = -way;
    for (Index e = 0; e <= last; ++e) d[e] *= way;
    return step_along(set, d, last + 1, INFINITE);
}

constexpr Index MANY = 8;  // vectors from which on they join together

// Let all used vectors join the factor; false at the first that depends on those before
// it.
template <class Terms>
bool factorise(const Terms& terms, ActiveSet& set, double dependent) {
    if (set.factor.size() == 0 && set.count >= MANY) {
        for (Index e = 0; e < set.count; ++e) {
            double* row = set.factor.row(e);
            terms.overlaps(set.index[e], set.index + e, set.count - e, row + e);
            row[set.count] = terms.linear_term(set.index[e], set.sign[e]);
        }
        return set.factor.append_all(set.count, dependent, Terms::scaled, set.column);
    }
    while (set.factor.size() < set.count) {
        const Index m = set.factor.size(), i = set.index[m];
        double* tail = set.column + padded(m + 1) - PADDING;
        for (Index e = 0; e < PADDING; ++e) tail[e] = 0;
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

// Minimise over the used coefficients; those that reach 0 on the way are dropped.
// `newest`: the last one has just been chosen; returns whether that one was dropped
// before it moved.
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

constexpr Index ROUNDS_BETWEEN_LOOKS = 16;  // most minimisations take fewer

// Minimise the program of `terms`, from the coefficients in the set; its solution is in
// the set then. A vector depends on others where the share of its square outside their
// span is at most `dependent`.
template <class Terms>
Ending minimise(Terms& terms, ActiveSet& set, double dependent, Index max_rounds) {
    set.factor.clear();
    bool newest = false;
    for (Index round = 1; round <= max_rounds; ++round) {
        if (round % ROUNDS_BETWEEN_LOOKS == 0) check_interrupt();
        const bool rejected = minimise_used(terms, set, dependent, newest);
        Index next = -1;
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
    double* score;  // (k,), scratch memory
    Index k;

    // Q_ii, the square of the length of vector i.
    double square(Index i) const { return Q[i * k + i]; }
    // h_i, the linear term of coefficient i.
    double linear_term(Index i, double) const { return h[i]; }
    // a_i, the factor of coefficient i in a^T x = 1.
    double size(Index i) const { return a[i]; }

    // out_e = Q_i,used_e for e < m, the inner products of vector i with the used ones.
    void overlaps(Index i, const Index* used, Index m, double* out) const {
        for (Index e = 0; e < m; ++e) out[e] = Q[i * k + used[e]];
    }

    // Set `next` to the coefficient to use next; false where there is none.
    bool choose(const ActiveSet& set, Index& next, double&) {
        const double mu = set.multiplier;
        for (Index i = 0; i < k; ++i) score[i] = has_scale ? h[i] - mu * a[i] : h[i];
        subtract_mixture(score, set.x, set.index, set.count, Q, k, k);
        for (Index i = 0; i < k; ++i) score[i] *= weight[i];
        for (Index e = 0; e < set.count; ++e) score[set.index[e]] = -INFINITE;
        const double best = largest_of(score, k);
        if (!(best > least)) return false;
        next = place_of(best, score, k);
        return true;
    }
};

}  // namespace shapefit
