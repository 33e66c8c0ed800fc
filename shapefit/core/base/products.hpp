// Products of small dense matrices with sums in registers.
//
//   C_ij += sign sum_k A_ki B_kj      for first <= k < last, which may depend on the tile
//
// Rows of B and C are padded and their strides multiples of PADDING; A is read number by number,
// in either order. A tile is 4 rows and up to 3 vectors wide.
#pragma once

#include "lanes.hpp"

namespace shapefit {

struct Factor {
    const double* data;
    long by_k, by_i;  // A_ki stands at data[k by_k + i by_i]
};

// A^T of a matrix whose rows are k, and A itself of one whose rows are i.
inline Factor transposed(const double* data, long stride) { return {data, stride, 1}; }
inline Factor plain(const double* data, long stride) { return {data, 1, stride}; }

struct Inner {
    long first, last;
};

constexpr long TILE_ROWS = 4;

template <int vectors>
[[gnu::always_inline]] inline void add_tile(double sign, Factor A, const double* B, double* C,
                                            long stride, Inner k, long stride_of_B) {
    Doubles sums[TILE_ROWS][vectors] = {};
    for (long e = k.first; e < k.last; ++e) {
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

// C (rows, columns) += sign A^T B; inner(i, j, width) the k of the tile from row i and column j on,
// where first > last leaves it out.
template <class Inside>
inline void add_product(double sign, Factor A, const double* B, double* C, long rows, long columns,
                        long stride_of_B, long stride, const Inside& inner) {
    for (long j = 0; j < columns;) {
        const long left = (columns - j) / WIDTH, vectors = left < 3 ? left : 3;
        for (long i = 0; i < rows; i += TILE_ROWS) {
            const Inner k = inner(i, j, vectors * WIDTH);
            if (k.first >= k.last) continue;
            const Factor part{A.data + i * A.by_i, A.by_k, A.by_i};
            double* to = C + i * stride + j;
            if (vectors == 3)
                add_tile<3>(sign, part, B + j, to, stride, k, stride_of_B);
            else if (vectors == 2)
                add_tile<2>(sign, part, B + j, to, stride, k, stride_of_B);
            else
                add_tile<1>(sign, part, B + j, to, stride, k, stride_of_B);
        }
        j += vectors * WIDTH;
    }
}

// Which k count: all of n; those of a factor A with A_ki = 0 for k > i, or of a B with B_kj = 0 for
// k < j; and, of a symmetric C, tiles that reach the upper triangle only.
inline auto every(long n) {
    return [n](long, long, long) { return Inner{0, n}; };
}
inline auto up_to_row() {
    return [](long i, long, long) { return Inner{0, i + TILE_ROWS}; };
}
inline auto from_column(long n) {
    return [n](long, long j, long) { return Inner{j, n}; };
}
inline auto upper(long n) {
    return [n](long i, long j, long width) { return Inner{0, i < j + width ? n : 0}; };
}
inline auto upper_from_column(long n) {
    return [n](long i, long j, long width) { return Inner{j, i < j + width ? n : 0}; };
}

}  // namespace shapefit
