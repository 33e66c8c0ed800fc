#include "coding.hpp"

#include "../base/registry.hpp"
#include "../base/dense_terms.hpp"

namespace shapefit {
namespace {

constexpr long MOST_ROUNDS = 10000;
constexpr double DEPENDENT = 1e-12;  // share of an atom's square outside the span of the others

}  // namespace

void code(const CodingData& data, Range range) {
    const long k = data.gram.size[0];
    Workspace workspace;
    ActiveSet set(workspace, k);
    double* weight = workspace.zeros<double>(k);
    double* score = workspace.zeros<double>(k);
    for (long i = 0; i < k; ++i) {
        const double square = data.gram[i][i];
        weight[i] = square > 0 ? 1 / root(square) : 0;
    }
    for (long shape = range.first; shape < range.last; ++shape) {
        const Vector<double> c = data.coefficients[shape];
        set.clear();
        for (long i = 0; i < k; ++i)
            if (c[i] > 0) set.use(i, c[i], 1);
        DenseTerms<false> terms{.Q = data.gram.data,
                                .h = data.pulls[shape].data,
                                .a = nullptr,
                                .weight = weight,
                                .least = data.smallest_moves[shape],
                                .score = score,
                                .k = k};
        const Ending ending = minimise(terms, set, DEPENDENT, MOST_ROUNDS);
        data.unsettled[shape] = ending != Ending::OPTIMAL;
        for (long i = 0; i < k; ++i) c[i] = 0;
        for (long e = 0; e < set.count; ++e) c[set.index[e]] = set.x[e];
    }
}

void find_objectives(const MisfitData& data, Range range) {
    const long k = data.atoms.size[0], d = data.atoms.size[1];
    Workspace workspace;
    long* used = workspace.zeros<long>(k + 1);
    double* x = workspace.zeros<double>(k + 1);
    double* residual = workspace.zeros<double>(padded(d));
    for (long shape = range.first; shape < range.last; ++shape) {
        const double *c = data.coefficients[shape].data, *S = data.shapes[shape].data;
        long m = 0;
        double penalty = 0;
        for (long i = 0; i < k; ++i) {
            used[m] = i;
            x[m] = c[i];
            m += c[i] != 0;
            penalty += c[i];
        }
        for (long j = 0; j < d; ++j) residual[j] = S[j];
        subtract_mixture(residual, x, used, m, data.atoms.data, d, d);
        data.objectives[shape] =
            0.5 * dot_padded(residual, residual, padded(d)) + data.beta * penalty;
    }
}

const Exported<code> code_exported{"code"};
const Exported<find_objectives> find_objectives_exported{"find_objectives"};

}  // namespace shapefit
