#include "blocks.hpp"

namespace shapefit {

double moreau(const double* M, const double* N, double step, const double* dN, double sigma,
              double t, double* total, long k) {
    Doubles value = {};
    for (long i = 0; i < k; i += WIDTH) {
        const BlockLanes m = load_blocks(M, k, i), n = load_blocks(N, k, i);
        const BlockLanes d = load_blocks(dN, k, i);
        Doubles q[6];
        for (int e = 0; e < 6; ++e) q[e] = m.q[e] + sigma * (n.q[e] + step * d.q[e]);
        const Invariants<Doubles> block = invariants(q);
        const Doubles plus = nuclear_norm(block);
        const Doubles minus = block.spread / larger(plus, all(TINY));
        store(total + i, plus);
        // both singular values become (plus - t) / 2, or the first alone falls by t
        const Doubles excess = larger(plus - t, Doubles{}), first = 0.5 * (plus + minus) - t;
        const Doubles second = 0.5 * (plus - minus);
        value += minus <= t ? 0.5 * excess * excess : first * first + second * second;
    }
    return sum(value);
}

void sum_singular_values(const double* M, const double* N, double sigma, double* total, long k) {
    for (long i = 0; i < k; i += WIDTH) {
        const BlockLanes m = load_blocks(M, k, i), n = load_blocks(N, k, i);
        Doubles q[6];
        for (int e = 0; e < 6; ++e) q[e] = m.q[e] + sigma * n.q[e];
        store(total + i, nuclear_norm(invariants(q)));
    }
}

double largest_nuclear_norm(const double* N, long k) {
    Doubles found = {};
    for (long i = 0; i < k; i += WIDTH) {
        const Invariants<Doubles> block = invariants(load_blocks(N, k, i).q);
        found = larger(found, block.trace + 2.0 * block.product);
    }
    return root(largest(found));
}

}  // namespace shapefit
