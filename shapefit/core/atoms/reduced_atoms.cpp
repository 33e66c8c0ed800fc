#include "reduced_atoms.hpp"

namespace shapefit {

void Reduction::set_weights(Vector<const double> omega) {
    visible_count = 0;
    double total = 0;
    for (Index j = 0; j < omega.size[0]; ++j) {
        if (!(omega[j] > 0)) continue;
        visible[visible_count] = j;
        h[visible_count] = omega[j];
        total += square(omega[j]);
        ++visible_count;
    }
    if (visible_count == 0) return;
    const double length = root(total);
    for (Index m = 0; m < visible_count; ++m) h[m] /= length;
    h[visible_count - 1] += 1;
    // |u + e|^2 = 2 (1 + u_last), so h h^T = 2 v v^T / v^T v
    const double scale = 1 / root(h[visible_count - 1]);
    for (Index m = 0; m < visible_count; ++m) h[m] *= scale;
}

void Reduction::reduce(const double* x, const double* omega, double* out,
                       double anchor) const {
    double along = 0;
    for (Index m = 0; m < visible_count; ++m)
        along += (x[visible[m]] - anchor) * omega[visible[m]] * h[m];
    for (Index m = 0; m < visible_count - 1; ++m)
        out[m] = (x[visible[m]] - anchor) * omega[visible[m]] - along * h[m];
}

void Reduction::expand(const double* y, double* out, Index p) const {
    double along = 0;
    for (Index m = 0; m < visible_count - 1; ++m) along += y[m] * h[m];
    for (Index j = 0; j < p; ++j) out[j] = 0;
    for (Index m = 0; m < visible_count - 1; ++m) out[visible[m]] = y[m] - along * h[m];
    out[visible[visible_count - 1]] = -along * h[visible_count - 1];
}

Planes make_planes(Tensor<const double> atoms, Workspace& workspace) {
    const Index k = atoms.size[0], p = atoms.size[2];
    Planes planes{workspace.zeros<double>(3 * p * padded(k)), p, padded(k)};
    for (Index i = 0; i < k; ++i) {
        check_interrupt();
        for (int b = 0; b < 3; ++b)
            for (Index j = 0; j < p; ++j) *planes.at(b, j, i) = atoms[i][b][j];
    }
    return planes;
}

namespace {

// N_i = Y B_i^T for `count` vectors of atoms from i on.
template <int count>
[[gnu::always_inline]] inline void correlate_some(const Planes& B, const double* y0,
                                                  const double* y1, double* N,
                                                  Index i) {
    Doubles sums[6][count] = {};
    for (Index j = 0; j < B.columns; ++j)
        for (int b = 0; b < 3; ++b)
            for (int v = 0; v < count; ++v) {
                const Doubles atoms = load(B.at(b, j, i + v * WIDTH));
                sums[b][v] += y0[j] * atoms;
                sums[3 + b][v] += y1[j] * atoms;
            }
    for (int e = 0; e < 6; ++e)
        for (int v = 0; v < count; ++v)
            store(N + e * B.padded_atoms + i + v * WIDTH, sums[e][v]);
}

// out_i = <X, B_i> for `count` vectors of atoms from i on.
template <int count>
[[gnu::always_inline]] inline void find_some_inner_products(const Planes& B,
                                                            const double* X,
                                                            double* out, Index i) {
    Doubles sums[3][count] = {};
    for (Index j = 0; j < B.columns; ++j)
        for (int b = 0; b < 3; ++b)
            for (int v = 0; v < count; ++v)
                sums[b][v] += X[b * B.columns + j] * load(B.at(b, j, i + v * WIDTH));
    for (int v = 0; v < count; ++v)
        store(out + i + v * WIDTH, sums[0][v] + sums[1][v] + sums[2][v]);
}

}  // namespace

void correlate(const Planes& B, const double* y0, const double* y1, double* N) {
    constexpr int PAIR = WIDTH == 8 ? 2 : 1;  // 12 sums of 32 registers, 6 of 16
    Index i = 0;
    for (; i + PAIR * WIDTH <= B.padded_atoms; i += PAIR * WIDTH)
        correlate_some<PAIR>(B, y0, y1, N, i);
    for (; i < B.padded_atoms; i += WIDTH) correlate_some<1>(B, y0, y1, N, i);
}

void find_inner_products(const Planes& B, const double* X, double* out) {
    constexpr int MANY = 4;
    Index i = 0;
    for (; i + MANY * WIDTH <= B.padded_atoms; i += MANY * WIDTH)
        find_some_inner_products<MANY>(B, X, out, i);
    for (; i < B.padded_atoms; i += WIDTH) find_some_inner_products<1>(B, X, out, i);
}

double ReducedAtoms::reduce(const double* omega, const Reduction& reduction) {
    resize(reduction.coordinates());
    double most = 0;
    for (Index i = 0; i < planes.padded_atoms; i += WIDTH) {
        check_interrupt();
        Doubles squares = {};
        for (int b = 0; b < 3; ++b) {
            Doubles along = {};
            for (Index m = 0; m < reduction.visible_count; ++m) {
                const Index j = reduction.visible[m];
                along += (omega[j] * reduction.h[m]) * load(all_.at(b, j, i));
            }
            for (Index m = 0; m < q(); ++m) {
                const Index j = reduction.visible[m];
                const Doubles x =
                    omega[j] * load(all_.at(b, j, i)) - reduction.h[m] * along;
                squares += x * x;
                store(planes.at(b, m, i), x);
            }
        }
        most = larger(most, largest(squares));
    }
    return root(most);
}

void ReducedAtoms::scale(double factor) {
    for (Index e = 0; e < planes.size(); e += WIDTH)
        store(planes.data + e, factor * load(planes.data + e));
}

// Set q; rows that were copied before are copied again when they are next asked for.
void ReducedAtoms::resize(Index coordinates) {
    planes.columns = coordinates;
    row = padded(coordinates);
    for (Index i = 0; i < k; ++i) is_copied_[i] = false;
}

// Copy atom i out of the planes into rows of its own, (3, row) with 0 at the end.
const double* ReducedAtoms::copy_rows(Index i) {
    double* B = rows_ + i * 3 * row;
    for (int b = 0; b < 3; ++b)
        for (Index j = 0; j < row; ++j)
            B[b * row + j] = j < q() ? *planes.at(b, j, i) : 0;
    is_copied_[i] = true;
    return B;
}

bool ReducedImage::reduce(Matrix<const double> W, Vector<const double> weights) {
    if (!last_weights_ || !are_equal(weights.data, last_weights_, weights.size[0])) {
        reduction.set_weights(weights);
        largest_norm = atoms.reduce(weights.data, reduction);
        for (Index j = 0; j < 2 * atoms.row; ++j) w[j] = 0;
    }
    last_weights_ = weights.data;
    if (reduction.visible_count < 2) return false;
    reduction.reduce_landmarks(W, weights.data, w, atoms.row);
    return true;
}

}  // namespace shapefit
