// Expectation and maximisation for a mixture of Gaussians over shapes x (d,):
//
//     log N(x; mu_k, C_k) = -1/2 |W_k (x - mu_k)|^2 + constant_k,    W_k = L_k^-1,
//     sum_n w_n x_n x_n^T,
//
// L_k the Cholesky factor of C_k. Shapes are taken in blocks that stay in the cache: by
// passes over all shapes, NumPy takes twice the time and more for each.
#include "../base/registry.hpp"
#include "../base/vectors.hpp"

namespace shapefit {
namespace {

// Shapes at a time.
constexpr Index BLOCK = IMAGES_PER_BLOCK;
// Weights up to which a shape adds nothing to a sum, beside others of about 1.
constexpr double MIN_WEIGHT = 1e-15;

// Shapes x, and the Gaussians whose densities are wanted.
struct DensityData {
    Arguments& from;
    Matrix<const double> shapes = from("shapes", "n d");
    Matrix<const double> means = from("means", "k d");
    Tensor<const double> whiten = from("whiten", "k d d");  // W, lower triangular
    Vector<const double> constants = from("constants", "k");
    Matrix<double> log_densities = from("log_densities", "n k");
};

// x^T (D, BLOCK) of `count` shapes from `first` on, and zeros.
void transpose_shapes(Matrix<const double> shapes, Index first, Index count,
                      double* x) {
    for (Index n = 0; n < count; ++n)
        for (Index i = 0; i < shapes.size[1]; ++i)
            x[i * BLOCK + n] = shapes[first + n][i];
    for (Index n = count; n < BLOCK; ++n)
        for (Index i = 0; i < shapes.size[1]; ++i) x[i * BLOCK + n] = 0;
}

// squares_n = sum_i z_in^2 for z (d, BLOCK).
void sum_squares(const double* z, Index d, double* squares) {
    for (Index n = 0; n < BLOCK; ++n) squares[n] = 0;
    for (Index i = 0; i < d; ++i)
        for (Index n = 0; n < BLOCK; ++n) squares[n] += square(z[i * BLOCK + n]);
}

// Write the log densities of the shapes of the range for all Gaussians.
void find_log_densities(const DensityData& data, Range range) {
    const Index K = data.means.size[0], d = data.means.size[1], D = padded(d);
    Workspace workspace;
    const Tensor<double> W = workspace.tensor<double>(K, D, D);
    for (Index k = 0; k < K; ++k)
        for (Index i = 0; i < d; ++i)
            for (Index j = 0; j <= i; ++j) W[k][i][j] = data.whiten[k][i][j];
    double* x = workspace.zeros<double>(D * BLOCK);
    double* centred = workspace.zeros<double>(D * BLOCK);
    double* z = workspace.zeros<double>(D * BLOCK);
    double squares[BLOCK];
    for (Index first = range.first; first < range.last; first += BLOCK) {
        const Index left = range.last - first, count = left < BLOCK ? left : BLOCK;
        transpose_shapes(data.shapes, first, count, x);
        for (Index k = 0; k < K; ++k) {
            check_interrupt();
            for (Index i = 0; i < d; ++i)
                for (Index n = 0; n < BLOCK; ++n)
                    centred[i * BLOCK + n] = x[i * BLOCK + n] - data.means[k][i];
            for (Index e = 0; e < D * BLOCK; ++e) z[e] = 0;
            add_product(1, plain(W[k].data, D), centred, z, D, BLOCK, BLOCK, BLOCK,
                        up_to_row());
            sum_squares(z, d, squares);
            for (Index n = 0; n < count; ++n)
                data.log_densities[first + n][k] = data.constants[k] - 0.5 * squares[n];
        }
    }
}

const Exported<find_log_densities> find_log_densities_exported{"find_log_densities"};

// Shapes x with weights w.
struct SumData {
    Arguments& from;
    Matrix<const double> shapes = from("shapes", "n d");
    Vector<const double> weights = from("weights", "n");
    Matrix<double> total = from("total", "d d");  // sum_n w_n x_n x_n^T
};

// S (D, D) <- S + sum_n y_n y_n^T over `count` rows y of D numbers, above the diagonal.
void add_squares(const double* y, Index count, Index D, double* S) {
    check_interrupt();
    add_product(1, transposed(y, D), y, S, D, D, D, D, upper(count));
}

// Write the weighted sum of x x^T over all shapes.
void sum_outer_products(const SumData& data) {
    const Index d = data.shapes.size[1], D = padded(d);
    Workspace workspace;
    double* S = workspace.zeros<double>(D * D);
    double* y = workspace.zeros<double>(BLOCK * D);
    Index count = 0;  // of rows y = sqrt(w) x
    for (Index n = 0; n < data.shapes.size[0]; ++n) {
        if (!(data.weights[n] > MIN_WEIGHT)) continue;
        const double factor = root(data.weights[n]);
        for (Index i = 0; i < d; ++i) y[count * D + i] = factor * data.shapes[n][i];
        if (++count < BLOCK) continue;
        add_squares(y, count, D, S);
        count = 0;
    }
    add_squares(y, count, D, S);
    for (Index i = 0; i < d; ++i)
        for (Index j = 0; j < d; ++j)
            data.total[i][j] = i < j ? S[i * D + j] : S[j * D + i];
}

const Exported<sum_outer_products> sum_outer_products_exported{"sum_outer_products"};

}  // namespace
}  // namespace shapefit
