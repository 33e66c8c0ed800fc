#include "blocks.hpp"

namespace shapefit::SHAPEFIT_LEVEL {

double moreau(const double* M, const double* N, double step, const double* dN, double sigma,
              double t, double* total, long k) {
    double value = 0;
    for (long i = 0; i < k; ++i) {
        const auto argument = [&](int e) {
            return M[e * k + i] + sigma * (N[e * k + i] + step * dN[e * k + i]);
        };
        const Invariants block = invariants(argument(0), argument(1), argument(2), argument(3),
                                            argument(4), argument(5));
        const double plus = root(block.trace + 2 * block.product);
        total[i] = plus;
        value += squared_prox(plus, block.spread / larger(plus, TINY), t);
    }
    return value;
}

}  // namespace shapefit::SHAPEFIT_LEVEL
