// Sums over rows of numbers and products of small dense matrices, in vector
// instructions. Padded rows end in zeros up to a multiple of PADDING.
#pragma once

#include "lanes.hpp"

namespace shapefit {

// sum_i a_i b_i
[[gnu::always_inline]] inline double dot(const double* a, const double* b, Index n) {
    double total = 0;
    for (Index i = 0; i < n; ++i) total += a[i] * b[i];
    return total;
}

// Whether x_i = y_i for all i < n; nan differs from itself.
inline bool are_equal(const double* x, const double* y, Index n) {
    for (Index i = 0; i < n; ++i)
        if (x[i] != y[i]) return false;
    return true;
}

// y += factor x; x and y are disjoint.
[[gnu::always_inline]] inline void add_to(double* __restrict y, double factor,
                                          const double* __restrict x, Index n) {
    for (Index i = 0; i < n; ++i) y[i] += factor * x[i];
}

// sum_i a_i b_i of padded rows of n numbers.
[[gnu::always_inline]] inline double dot_padded(const double* a, const double* b,
                                                Index n) {
    Doubles even = {}, odd = {};
    Index i = 0;
    for (; i + 2 * WIDTH <= n; i += 2 * WIDTH) {
        even += load(a + i) * load(b + i);
        odd += load(a + i + WIDTH) * load(b + i + WIDTH);
    }
    for (; i < n; i += WIDTH) even += load(a + i) * load(b + i);
    return sum(even + odd);
}

// P = S S^T (3, 3) for S (3, row), its rows padded.
inline void find_gram(const double* S, Index row, double* P) {
    for (int a = 0; a < 3; ++a)
        for (int b = 0; b <= a; ++b)
            P[3 * a + b] = P[3 * b + a] = dot_padded(S + a * row, S + b * row, row);
}

// Columns `column` .. column + count * WIDTH - 1 of out = sum_r x_r row_r; see
// mix_rows.
template <int count>
[[gnu::always_inline]] inline void mix_columns(const double* x, Index m,
                                               const double* rows, Index stride,
                                               Index column, double* out) {
    Doubles sums[count] = {};
    for (Index r = 0; r < m; ++r)
        for (int v = 0; v < count; ++v)
            sums[v] += x[r] * load(rows + r * stride + column + v * WIDTH);
    for (int v = 0; v < count; ++v) store(out + column + v * WIDTH, sums[v]);
}

// The last `left` vectors of columns of out = sum_r x_r row_r, from `column` on, left
// <= most; see mix_rows. All at once: each sum alone would wait for itself.
template <int most>
[[gnu::always_inline]] inline void mix_last_columns(Index left, const double* x,
                                                    Index m, const double* rows,
                                                    Index stride, Index column,
                                                    double* out) {
    if (left == most) mix_columns<most>(x, m, rows, stride, column, out);
    else if constexpr (most > 1)
        mix_last_columns<most - 1>(left, x, m, rows, stride, column, out);
}

// out = sum_r x_r row_r for m padded rows of n numbers, `stride` apart.
inline void mix_rows(const double* x, Index m, const double* rows, Index stride,
                     Index n, double* out) {
    constexpr int MAX_SUMS = 8;  // as many sums as hide the latency
    Index column = 0;
    for (; column + MAX_SUMS * WIDTH <= n; column += MAX_SUMS * WIDTH)
        mix_columns<MAX_SUMS>(x, m, rows, stride, column, out);
    mix_last_columns<MAX_SUMS - 1>((n - column) / WIDTH, x, m, rows, stride, column,
                                   out);
}

// y -= sum_e x_e row_(index_e) over e < m, for rows of n numbers, `stride` apart.
inline void subtract_mixture(double* __restrict y, const double* __restrict x,
                             const Index* __restrict index, Index m,
                             const double* __restrict rows, Index stride, Index n) {
    Index e = 0;
    for (; e + 4 <= m; e += 4) {
        const double *r0 = rows + index[e] * stride, *r1 = rows + index[e + 1] * stride;
        const double *r2 = rows + index[e + 2] * stride,
                     *r3 = rows + index[e + 3] * stride;
        const double x0 = x[e], x1 = x[e + 1], x2 = x[e + 2], x3 = x[e + 3];
        for (Index i = 0; i < n; ++i)
            y[i] -= x0 * r0[i] + x1 * r1[i] + x2 * r2[i] + x3 * r3[i];
    }
    for (; e < m; ++e) {
        const double* row = rows + index[e] * stride;
        for (Index i = 0; i < n; ++i) y[i] -= x[e] * row[i];
    }
}

// The largest of n numbers that is not nan; -infinity where there is none.
inline double largest_of(const double* x, Index n) {
    double best[PADDING];
    for (Index lane = 0; lane < PADDING; ++lane) best[lane] = -INFINITE;
    Index i = 0;
    for (; i + PADDING <= n; i += PADDING)
        for (Index lane = 0; lane < PADDING; ++lane)
            best[lane] = larger(x[i + lane], best[lane]);
    for (; i < n; ++i) best[0] = larger(x[i], best[0]);
    for (Index lane = 1; lane < PADDING; ++lane) best[0] = larger(best[lane], best[0]);
    return best[0];
}

// The first i with x_i = value; n where there is none.
inline Index place_of(double value, const double* x, Index n) {
    Index i = 0;
    while (i < n && x[i] != value) ++i;
    return i;
}

// Products of small dense matrices with sums in registers.
//
//     C_ij += sign sum_k A_ki B_kj
//
// over first <= k < last, which may depend on the tile.
//
// Rows of B and C are padded and their strides multiples of PADDING; A is read number
// by number, in either order. A tile is 4 rows and up to 3 vectors wide.

// A matrix A that is read number by number.
struct Factor {
    const double* data;
    Index by_k, by_i;  // A_ki is data[k * by_k + i * by_i]
};

// The factor by which a product becomes C += sign X^T B, and that by which it becomes
// C += sign X B, of a row-major matrix X with rows `stride` apart.
inline Factor transposed(const double* data, Index stride) { return {data, stride, 1}; }
inline Factor plain(const double* data, Index stride) { return {data, 1, stride}; }

// first <= k < last, over which a tile is summed.
struct Inner {
    Index first, last;
};

constexpr Index TILE_ROWS = 4;

// C_ij += sign sum_k A_ki B_kj for TILE_ROWS rows i and so many vectors of columns j.
template <int vectors>
[[gnu::always_inline]] inline void add_tile(double sign, Factor A, const double* B,
                                            double* C, Index stride, Inner k,
                                            Index stride_of_B) {
    Doubles sums[TILE_ROWS][vectors] = {};
    for (Index e = k.first; e < k.last; ++e) {
        const double* a = A.data + e * A.by_k;
        Doubles b[vectors];
        for (int v = 0; v < vectors; ++v) b[v] = load(B + e * stride_of_B + v * WIDTH);
        for (int r = 0; r < TILE_ROWS; ++r)
            for (int v = 0; v < vectors; ++v) sums[r][v] += a[r * A.by_i] * b[v];
    }
    for (int r = 0; r < TILE_ROWS; ++r)
        for (int v = 0; v < vectors; ++v) {
            double* to = C + r * stride + v * WIDTH;
            store(to, load(to) + sign * sums[r][v]);
        }
}

// C_ij += sign sum_k A_ki B_kj for C (rows, columns), its rows `stride` apart;
// inner(i, j, width) returns the range of k of the tile from row i and column j on, an
// empty one for a tile that is left out.
template <class Inside>
inline void add_product(double sign, Factor A, const double* B, double* C, Index rows,
                        Index columns, Index stride_of_B, Index stride,
                        const Inside& inner) {
    for (Index j = 0; j < columns;) {
        const Index left = (columns - j) / WIDTH, vectors = left < 3 ? left : 3;
        for (Index i = 0; i < rows; i += TILE_ROWS) {
            const Inner k = inner(i, j, vectors * WIDTH);
            if (k.first >= k.last) continue;
            const Factor part{A.data + i * A.by_i, A.by_k, A.by_i};
            double* to = C + i * stride + j;
            if (vectors == 3)
                add_tile<3>(sign, part, B + j, to, stride, k, stride_of_B);
            else if (vectors == 2)
                add_tile<2>(sign, part, B + j, to, stride, k, stride_of_B);
            else add_tile<1>(sign, part, B + j, to, stride, k, stride_of_B);
        }
        j += vectors * WIDTH;
    }
}

// The last argument of add_product: which k a tile is summed over.

// Each tile is summed over all k < n.
inline auto every(Index n) {
    return [n](Index, Index, Index) { return Inner{0, n}; };
}
// Each tile is summed over the k up to its last row, for A_ki = 0 at k > i.
inline auto up_to_row() {
    return [](Index i, Index, Index) { return Inner{0, i + TILE_ROWS}; };
}
// Each tile is summed over the k < n from its first column on, for B_kj = 0 at k < j.
inline auto from_column(Index n) {
    return [n](Index, Index j, Index) { return Inner{j, n}; };
}
// Tiles that reach the upper triangle of C are summed over all k < n; others are left
// out.
inline auto upper(Index n) {
    return
        [n](Index i, Index j, Index width) { return Inner{0, i < j + width ? n : 0}; };
}
// Tiles that reach the upper triangle of C are summed as by `from_column`; others are
// left out.
inline auto upper_from_column(Index n) {
    return
        [n](Index i, Index j, Index width) { return Inner{j, i < j + width ? n : 0}; };
}

}  // namespace shapefit
