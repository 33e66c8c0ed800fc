// Steps of dictionary learning: codes of shapes, and new atoms for given codes.
#include "../base/registry.hpp"
#include "../base/active_set.hpp"

namespace shapefit {

// min_c 1/2 c^T G c - h^T c over c >= 0, for each shape.
struct CodingData {
    Arguments& from;
    Matrix<const double> gram = from("gram", "k k");  // G = B B^T
    Matrix<const double> pulls = from("pulls", "n k");  // h = S B^T - beta
    // by which a coefficient still has to move the shape
    Vector<const double> smallest_moves = from("smallest_moves", "n");
    Matrix<double> coefficients = from("coefficients", "n k");  // c >= 0, the start, overwritten
    Vector<bool> unsettled = from("unsettled", "n");  // where the moves did not become smaller
};

// 1/2 ||S - sum_i c_i B_i||^2 + beta sum_i c_i, for each shape.
struct MisfitData {
    Arguments& from;
    Matrix<const double> shapes = from("shapes", "n d");  // S
    Matrix<const double> atoms = from("atoms", "k d");  // B
    Matrix<const double> coefficients = from("coefficients", "n k");  // c
    double beta = from("beta");
    Vector<double> objectives = from("objectives", "n");
};

// A += C^T C and D += C^T X: all that the best atoms for coefficients C depend on.
struct ProductsData {
    Arguments& from;
    Matrix<const double> shapes = from("shapes", "n d");  // X
    Matrix<const double> coefficients = from("coefficients", "n k");  // C
    Matrix<double> overlaps = from("overlaps", "k k");  // A
    Matrix<double> pulls = from("pulls", "k d");  // D
};

// min_B 1/2 ||X - C B||_F^2 over rows ||B_i|| <= bound, some sweeps of it.
struct AtomUpdateData {
    Arguments& from;
    Matrix<const double> overlaps = from("overlaps", "k k");  // A = C^T C
    Matrix<const double> pulls = from("pulls", "k d");  // D = C^T X
    Matrix<double> atoms = from("atoms", "k d");  // B, overwritten
    double bound = from("bound");
    long sweeps = from("sweeps");
};

namespace {

constexpr long MOST_ROUNDS = 10000;
constexpr double DEPENDENT = 1e-12;  // share of an atom's square outside the span of the others

}  // namespace

// min_c 1/2 ||S - sum_i c_i B_i||_F^2 + beta sum_i c_i over c >= 0, for the shapes of the range.
//
// The next atom is the one that a coordinate descent step would move the shape by most with.
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
        set.write(c);
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

namespace {

// The rows of a matrix, padded with zeros to whole vectors.
double* padded_rows(Workspace& workspace, Matrix<const double> rows, long width) {
    double* padded = workspace.zeros<double>(rows.size[0] * width);
    for (long i = 0; i < rows.size[0]; ++i)
        for (long j = 0; j < rows.size[1]; ++j) padded[i * width + j] = rows[i][j];
    return padded;
}

}  // namespace

// A += C^T C, D += C^T X, shape by shape: the sums do not depend on where batches of shapes end.
// Coefficients are few: those that are not 0 add their products.
void add_products(const ProductsData& data) {
    const long k = data.overlaps.size[0], d = data.pulls.size[1];
    Workspace workspace;
    long* used = workspace.zeros<long>(k + 1);
    for (long shape = 0; shape < data.shapes.size[0]; ++shape) {
        const double *c = data.coefficients[shape].data, *x = data.shapes[shape].data;
        long m = 0;
        for (long i = 0; i < k; ++i) {
            used[m] = i;
            m += c[i] != 0;
        }
        for (long e = 0; e < m; ++e) {
            const double share = c[used[e]];
            double* __restrict A = data.overlaps[used[e]].data;
            double* __restrict D = data.pulls[used[e]].data;
            for (long f = 0; f < m; ++f) A[used[f]] += share * c[used[f]];
            for (long j = 0; j < d; ++j) D[j] += share * x[j];
        }
    }
}

// Lower 1/2 ||X - C B||_F^2 over the rows of B within the ball ||B_i|| <= bound:
//
//   A = C^T C,  D = C^T X,  B_i <- projection of  B_i + (D_i - sum_l A_il B_l) / A_ii  on the ball,
//
// one atom after another, `sweeps` times. Atoms that no shape uses stay as they are.
void update_atoms(const AtomUpdateData& data) {
    const long k = data.atoms.size[0], d = data.atoms.size[1], width = padded(d);
    Workspace workspace;
    const double* pulls = padded_rows(workspace, data.pulls, width);
    double* B = padded_rows(workspace, data.atoms, width);
    double* mixed = workspace.zeros<double>(width);
    for (long sweep = 0; sweep < data.sweeps; ++sweep)
        for (long i = 0; i < k; ++i) {
            const double *A = data.overlaps[i].data, *D = pulls + i * width;
            if (!(A[i] > 0)) continue;
            double* __restrict one = B + i * width;
            mix_rows(A, k, B, width, width, mixed);
            for (long j = 0; j < width; ++j) one[j] += (D[j] - mixed[j]) / A[i];
            const double norm = root(dot_padded(one, one, width));
            const double scale = data.bound / larger(norm, data.bound);
            for (long j = 0; j < width; ++j) one[j] *= scale;
        }
    for (long i = 0; i < k; ++i)
        for (long j = 0; j < d; ++j) data.atoms[i][j] = B[i * width + j];
}

const Exported<code> code_exported{"code"};
const Exported<find_objectives> find_objectives_exported{"find_objectives"};
const Exported<add_products> add_products_exported{"add_products"};
const Exported<update_atoms> update_atoms_exported{"update_atoms"};

}  // namespace shapefit
