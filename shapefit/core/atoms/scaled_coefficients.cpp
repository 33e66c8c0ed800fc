#include "scaled_coefficients.hpp"

#include "../base/registry.hpp"
#include "../base/active_set.hpp"

namespace shapefit {
namespace {

constexpr double SLACK = 1e-10;  // by which a multiplier may have the wrong sign, beside |h|
constexpr double DEPENDENT = 1e-14;  // share of Q_ii below which a pivot is lifted

}  // namespace

ScaledProgram::ScaledProgram(Workspace& workspace, long k)
    : set(workspace, k), score(workspace.zeros<double>(k)), weight(workspace.zeros<double>(k)) {
    for (long i = 0; i < k; ++i) weight[i] = 1;
}

void scaled_coefficients(ScaledProgram& program, Matrix<const double> Q, Vector<const double> h,
                         Vector<const double> a, Vector<double> x) {
    const long k = x.size[0];
    ActiveSet& set = program.set;
    double largest = 0;
    set.clear();
    for (long i = 0; i < k; ++i) {
        largest = larger(magnitude(h[i]), largest);
        if (x[i] > 0) set.use(i, x[i], 1);
    }
    DenseTerms<true> terms{.Q = Q.data,
                           .h = h.data,
                           .a = a.data,
                           .weight = program.weight,
                           .least = SLACK * largest,
                           .score = program.score,
                           .k = k};
    minimise(terms, set, DEPENDENT, 10 * k + 100);
    for (long i = 0; i < k; ++i) x[i] = 0;
    for (long e = 0; e < set.count; ++e) x[set.index[e]] = set.x[e];
}

void solve_scaled(Matrix<const double> Q, Vector<const double> h, Vector<const double> a,
                  Vector<double> x) {
    Workspace workspace;
    ScaledProgram program(workspace, x.size[0]);
    scaled_coefficients(program, Q, h, a, x);
}

const Exported<solve_scaled> scaled_coefficients_exported{"scaled_coefficients", PART};

}  // namespace shapefit
