// Terms of the active-set method for a matrix Q given in full:
//
//   min_x 1/2 x^T Q x - h^T x   over x >= 0, and where `has_scale` a^T x = 1.
//
// The next coefficient is the one with the largest weight_i (h - Q x - mu a)_i beyond `least`.
#pragma once

#include "active_set.hpp"

namespace shapefit {

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
    double pull(long i, double) const { return h[i]; }
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
