// Sparse codes of shapes S (3 p,) for atoms B,
//
//     min_c 1/2 ||S - sum_i c_i B_i||_F^2 + beta sum_i c_i over c >= 0.
#include "../base/registry.hpp"
#include "../base/active_set.hpp"

namespace shapefit {

// min_c 1/2 c^T G c - h^T c over c >= 0, for each shape.
struct CodingData {
    Arguments& from;
    Matrix<const double> gram = from("gram", "k k");  // G = B B^T
    // h = S B^T - beta
    Matrix<const double> linear_terms = from("linear_terms", "n k");
    // by which a coefficient still has to move the shape
    Vector<const double> smallest_moves = from("smallest_moves", "n");
    // c >= 0, the start, overwritten
    Matrix<double> coefficients = from("coefficients", "n k");
    // where the moves did not become smaller
    Vector<bool> unsettled = from("unsettled", "n");
};

constexpr Index MAX_ROUNDS = 10000;
// Share of an atom's square outside the span of the others.
constexpr double DEPENDENT = 1e-12;

// Write the sparse code of each shape of the range,
//
//     argmin_c 1/2 ||S - sum_i c_i B_i||_F^2 + beta sum_i c_i over c >= 0.
//
// The next atom is the one with which a step of coordinate descent would move the shape
// most.
void code(const CodingData& data, Range range) {
    const Index k = data.gram.size[0];
    Workspace workspace;
    ActiveSet set(workspace, k);
    double* weight = workspace.zeros<double>(k);
    double* score = workspace.zeros<double>(k);
    for (Index i = 0; i < k; ++i) {
        const double square = data.gram[i][i];
        weight[i] = square > 0 ? 1 / root(square) : 0;
    }
    for (Index shape = range.first; shape < range.last; ++shape) {
        check_interrupt();
        const Vector<double> c = data.coefficients[shape];
        set.clear();
        for (Index i = 0; i < k; ++i)
            if (c[i] > 0) set.use(i, c[i], 1);
        DenseTerms<false> terms{.Q = data.gram.data,
                                .h = data.linear_terms[shape].data,
                                .a = nullptr,
                                .weight = weight,
                                .least = data.smallest_moves[shape],
                                .score = score,
                                .k = k};
        const Ending ending = minimise(terms, set, DEPENDENT, MAX_ROUNDS);
        data.unsettled[shape] = ending != Ending::OPTIMAL;
        set.write(c);
    }
}

const Exported<code> code_exported{"code"};

}  // namespace shapefit
