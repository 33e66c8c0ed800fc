#include "gram.hpp"

#include "../base/shared_loop.hpp"
#include "../base/vectors.hpp"

namespace shapefit {
namespace {

constexpr int BLOCK = 4;  // rows of the factor at a time
// Vectors of columns at a time: 4 x 4 sums fill half of 32 registers, 4 x 2 half of 16.
constexpr int TILE = WIDTH == 8 ? 4 : 2;
// Vectors of columns that hold the diagonal block. Where it is narrower than one, tiles
// begin at the vector that it is in, so that none straddles two lines of the cache;
// nobody reads what is left of it.
constexpr int DIAGONAL = WIDTH >= BLOCK ? 1 : BLOCK / WIDTH;
constexpr Index GRID = WIDTH >= BLOCK ? WIDTH : BLOCK;
// Where the vector of columns that holds column i begins.
constexpr Index grid_at(Index i) { return i / GRID * GRID; }
// Pivots that rounding has made tiny or negative are lifted to this share of their
// diagonal: the step stays a descent direction.
constexpr double MIN_PIVOT = 1e-14;

// Columns from which on a factorisation takes long: then it goes by panels, and looks
// at the clock.
constexpr Index LARGE = 256;
// Rows of a panel, which stay in the cache; a multiple of BLOCK.
constexpr Index PANEL = 64;
// Rows that a thread takes at a time, multiples of BLOCK: of F^T F, for which it reads
// all of F once more, and below a panel of the factorisation, which stays in the cache.
constexpr Index SUMMED_ROWS = 128, ELIMINATED_ROWS = 32;

// n, up to the next multiple of BLOCK.
constexpr Index blocks_of(Index n) { return (n + BLOCK - 1) / BLOCK * BLOCK; }

// sums += sign * share^T row for BLOCK numbers `share` and `count` vectors of a row of
// F or of the factor.
template <int count>
[[gnu::always_inline]] inline void add_row(const double* row, const double* share,
                                           double sign, Doubles (&sums)[BLOCK][count]) {
    for (int v = 0; v < count; ++v) {
        const Doubles columns = load(row + v * WIDTH);
        for (int r = 0; r < BLOCK; ++r) sums[r][v] += (sign * share[r]) * columns;
    }
}

// A tile of rows i .. i + 3 and `count` vectors of columns, summed in registers. Narrow
// ones take turns between several sums, or each addition would wait for the one before.
template <int count>
struct Tile {
    static constexpr int TURNS = count < 3 ? 2 : 1;
    static_assert(BLOCK % TURNS == 0);

    Doubles parts[TURNS][BLOCK][count];

    // Set the tile to rows i .. i + 3 of the factor, from column j on.
    [[gnu::always_inline]] void load_factor(const GramSystem& s, Index i, Index j) {
        for (int r = 0; r < BLOCK; ++r)
            for (int v = 0; v < count; ++v) {
                parts[0][r][v] =
                    load(s.factor + (i + r) * s.factor_stride + j + v * WIDTH);
                for (int t = 1; t < TURNS; ++t) parts[t][r][v] = Doubles{};
            }
    }

    // Add F^T F to the tile at rows i .. i + 3, from column j on.
    [[gnu::always_inline]] void add_squares(const GramSystem& s, Index i, Index j) {
        Index f = 0;
        for (; f + TURNS <= s.rows; f += TURNS)
            for (int t = 0; t < TURNS; ++t)
                add_row<count>(s.F + (f + t) * s.stride + j,
                               s.F + (f + t) * s.stride + i, 1, parts[t]);
        for (; f < s.rows; ++f)
            add_row<count>(s.F + f * s.stride + j, s.F + f * s.stride + i, 1, parts[0]);
    }

    // Eliminate rows first <= m < end of the factor from the tile.
    [[gnu::always_inline]] void subtract_rows(const GramSystem& s, Index i, Index j,
                                              Index first, Index end) {
        for (Index m = first; m < end; m += TURNS)
            for (int t = 0; t < TURNS; ++t)
                add_row<count>(s.factor + (m + t) * s.factor_stride + j,
                               s.scaled + (m + t) * s.factor_stride + i, -1, parts[t]);
    }

    // sums = the tile, the sum of its parts.
    [[gnu::always_inline]] void sum(Doubles (&sums)[BLOCK][count]) const {
        for (int r = 0; r < BLOCK; ++r)
            for (int v = 0; v < count; ++v) {
                sums[r][v] = parts[0][r][v];
                for (int t = 1; t < TURNS; ++t) sums[r][v] += parts[t][r][v];
            }
    }
};

// Factorise the diagonal block of rows i .. i + 3 as L D L^T: share[m][r] = L_rm, times
// which row m is subtracted from row r.
template <int count>
[[gnu::always_inline]] inline void factorise_diagonal(
    const GramSystem& s, Index i, const Doubles (&sums)[BLOCK][count],
    double (&share)[BLOCK][BLOCK]) {
    const Index at = i - grid_at(i);
    double block[BLOCK][DIAGONAL * WIDTH];
    for (int r = 0; r < BLOCK; ++r)
        for (int v = 0; v < DIAGONAL; ++v) store(block[r] + v * WIDTH, sums[r][v]);
    for (int m = 0; m < BLOCK; ++m) {
        double pivot = block[m][at + m];
        if (s.least) pivot = larger(pivot, s.least[i + m]);
        s.inverse[i + m] = 1 / pivot;
        for (int r = m + 1; r < BLOCK; ++r) {
            share[m][r] = block[m][at + r] * s.inverse[i + m];
            for (int c = r; c < BLOCK; ++c)
                block[r][at + c] -= share[m][r] * block[m][at + c];
        }
    }
}

// Subtract from each row of a block those above it, and store the rows, also scaled by
// their inverse pivots.
template <int count>
[[gnu::always_inline]] inline void eliminate_and_store(
    const GramSystem& s, Index i, Index j, const double (&share)[BLOCK][BLOCK],
    Doubles (&sums)[BLOCK][count]) {
    for (int r = 0; r < BLOCK; ++r)
        for (int v = 0; v < count; ++v) {
            for (int m = 0; m < r; ++m) sums[r][v] -= share[m][r] * sums[m][v];
            const Index at = (i + r) * s.factor_stride + j + v * WIDTH;
            store(s.factor + at, sums[r][v]);
            store(s.scaled + at, s.inverse[i + r] * sums[r][v]);
        }
}

// Factorise a tile: rows i .. i + 3, `count` vectors of columns from j on; rows before
// `above` have been eliminated from it already. The `first` tile of these rows holds
// the diagonal and sets `share`, see `factorise_diagonal`; the others read it.
template <int count, bool first>
void factorise_tile(const GramSystem& s, Index i, Index j, Index above,
                    double (&share)[BLOCK][BLOCK]) {
    Tile<count> tile;
    tile.load_factor(s, i, j);
    tile.add_squares(s, i, j);
    tile.subtract_rows(s, i, j, above, i);
    Doubles sums[BLOCK][count];
    tile.sum(sums);
    if constexpr (first) factorise_diagonal<count>(s, i, sums, share);
    eliminate_and_store<count>(s, i, j, share, sums);
}

// Factorise the next tile of rows i .. i + 3, from column j on, by `factorise_tile`. It
// takes as many of the `left` vectors of columns as fit into TILE, or one fewer where a
// single one would remain in the end, unless TILE is 2; returns how many.
template <bool first>
Index factorise_next_tile(const GramSystem& s, Index i, Index j, Index above,
                          Index left, double (&share)[BLOCK][BLOCK]) {
    const Index count = left > TILE && left % TILE == 1 && TILE > 2 ? TILE - 1 : left;
    if (count >= TILE) return factorise_tile<TILE, first>(s, i, j, above, share), TILE;
    if (count == 3) return factorise_tile<3, first>(s, i, j, above, share), 3;
    if (count == 2) return factorise_tile<2, first>(s, i, j, above, share), 2;
    return factorise_tile<first ? DIAGONAL : 1, first>(s, i, j, above, share),
           first ? DIAGONAL : 1;
}

// How many vectors of columns there are from the diagonal of row i on, that of r
// included.
Index vectors_from(const GramSystem& s, Index i) {
    return (s.columns + 1 - grid_at(i) + WIDTH - 1) / WIDTH;
}

// Factorise rows i .. i + 3, from which rows before `above` have been eliminated
// already.
void eliminate_rows(const GramSystem& s, Index i, Index above) {
    double share[BLOCK][BLOCK];
    const Index start = grid_at(i);
    Index left = vectors_from(s, i);
    Index taken = factorise_next_tile<true>(s, i, start, above, left, share);
    for (Index j = start; left > taken;) {
        j += taken * WIDTH;
        left -= taken;
        taken = factorise_next_tile<false>(s, i, j, above, left, share);
    }
}

// Solve L^T x = D^-1 z from below, four unknowns at a time; x is as wide as the
// columns. The four found last stay in registers: a vector cannot be loaded yet from
// where they were stored one by one.
void substitute_back(const GramSystem& s, double* x) {
    double below[BLOCK] = {};
    for (Index i = s.columns - BLOCK; i >= 0; i -= BLOCK) {
        double values[BLOCK];
        for (int r = 0; r < BLOCK; ++r) {
            const double* row = s.scaled + (i + r) * s.factor_stride;
            double sum = 0;
            for (Index j = i + 2 * BLOCK; j < s.columns; ++j) sum += row[j] * x[j];
            if (i + BLOCK < s.columns)
                for (int c = 0; c < BLOCK; ++c) sum += row[i + BLOCK + c] * below[c];
            values[r] = row[s.columns] - sum;
        }
        for (int r = BLOCK - 1; r >= 0; --r) {
            const double* row = s.scaled + (i + r) * s.factor_stride;
            for (int c = r + 1; c < BLOCK; ++c) values[r] -= row[i + c] * values[c];
        }
        for (int r = 0; r < BLOCK; ++r) x[i + r] = below[r] = values[r];
    }
}

// Set the least pivot of each column, a share of its diagonal of C + F^T F.
void find_least_pivots(const GramSystem& s) {
    for (Index i = 0; i < s.columns; ++i)
        s.least[i] = s.factor[i * s.factor_stride + i];
    for (Index f = 0; f < s.rows; ++f)
        for (Index i = 0; i < s.columns; ++i)
            s.least[i] += square(s.F[f * s.stride + i]);
    for (Index i = 0; i < s.columns; ++i)
        s.least[i] = larger(MIN_PIVOT * s.least[i], TINY);
}

// Load, change and store the tile of `factor` at rows i .. i + 3 and the next vectors
// of columns from j on, `most` of them or as many as are `left`; returns how many.
template <int most, class Change>
Index change_tile(const GramSystem& s, Index i, Index j, Index left,
                  const Change& change) {
    if (left < most) {
        if constexpr (most > 1) return change_tile<most - 1>(s, i, j, left, change);
    }
    Tile<most> tile;
    tile.load_factor(s, i, j);
    change(tile, i, j);
    Doubles sums[BLOCK][most];
    tile.sum(sums);
    for (int r = 0; r < BLOCK; ++r)
        for (int v = 0; v < most; ++v)
            store(s.factor + (i + r) * s.factor_stride + j + v * WIDTH, sums[r][v]);
    return most;
}

// Change `factor` tile by tile from the diagonal on, in rows first <= i < end.
template <class Change>
void change_rows(const GramSystem& s, Index first, Index end, const Change& change) {
    for (Index i = first; i < end; i += BLOCK) {
        check_interrupt();
        Index left = vectors_from(s, i);
        for (Index j = grid_at(i); left > 0;) {
            const Index taken = change_tile<TILE>(s, i, j, left, change);
            j += taken * WIDTH;
            left -= taken;
        }
    }
}

// Multiplications that the upper triangle of so many rows takes, `depth` a number.
double multiplications(Index rows, Index depth) { return 0.5 * rows * rows * depth; }

// C <- C + F^T F in rows first <= i < end, by panels of F.
void add_squares(const GramSystem& s, Index first, Index end) {
    GramSystem panel = s;
    for (Index f = 0; f < s.rows; f += PANEL) {
        panel.F = s.F + f * s.stride;
        panel.rows = s.rows - f < PANEL ? s.rows - f : PANEL;
        change_rows(s, first, end, [&](auto& tile, Index i, Index j) {
            tile.add_squares(panel, i, j);
        });
    }
}

// C <- C + F^T F.
void add_squares(const GramSystem& s) {
    share_out(0, s.columns, SUMMED_ROWS, multiplications(s.columns, s.rows),
              [&](Index first, Index end) { add_squares(s, first, end); });
}

// Eliminate rows first <= m < end of the factor, a panel, from all rows below.
void eliminate_panel(const GramSystem& s, Index first, Index end) {
    const auto eliminate = [&](auto& tile, Index i, Index j) {
        tile.subtract_rows(s, i, j, first, end);
    };
    share_out(end, s.columns, ELIMINATED_ROWS,
              multiplications(s.columns - end, end - first),
              [&](Index from, Index to) { change_rows(s, from, to, eliminate); });
}

// Factorise C + F^T F, where the factor holds C and r, four rows at a time.
void factorise(const GramSystem& s) {
    for (Index i = 0; i < s.columns; i += BLOCK) eliminate_rows(s, i, 0);
}

// Factorise C + F^T F by panels of rows, each of which is eliminated from all rows
// below at once: what it reads stays in the cache.
void factorise_by_panels(GramSystem s) {
    add_squares(s);
    s.rows = 0;
    for (Index first = 0; first < s.columns; first += PANEL) {
        const Index end = first + PANEL < s.columns ? first + PANEL : s.columns;
        for (Index i = first; i < end; i += BLOCK) {
            check_interrupt();
            eliminate_rows(s, i, first);
        }
        eliminate_panel(s, first, end);
    }
}

// Factorise C + F^T F, where the factor holds C and r, and solve for x.
void solve_system(const GramSystem& s, double* x) {
    if (s.least) find_least_pivots(s);
    if (s.columns < LARGE) factorise(s);
    else factorise_by_panels(s);
    substitute_back(s, x);
}

// Set the factor to C = shift I (n, n), with r as its last column.
void begin_with_shift(const GramSystem& s, double shift, const double* r, Index n) {
    const Index width = s.columns + 1;
    for (Index i = 0; i < s.columns; ++i) {
        double* row = s.factor + i * s.factor_stride;
        for (Index j = grid_at(i); j < width; j += WIDTH) store(row + j, Doubles{});
        row[i] = i < n ? shift : 1;
        row[s.columns] = i < n ? r[i] : 0;
    }
}

// Set the factor to C (n, n), with r as its last column.
void begin_with_matrix(const GramSystem& s, const double* C, const double* r, Index n) {
    begin_with_shift(s, 0, r, n);
    for (Index i = 0; i < n; ++i)
        for (Index j = i / BLOCK * BLOCK; j < n; ++j)
            s.factor[i * s.factor_stride + j] = C[i * n + j];
}

}  // namespace

// How many numbers apart rows of so many columns are. Tiles read and write up to
// DIAGONAL vectors beyond the last column; and rows are an odd number of lines of the
// cache apart, or many of them would share the same few places in it.
constexpr Index stride_for(Index columns) {
    constexpr Index LINE = PADDING;
    return (padded(columns + 1 + DIAGONAL * WIDTH) / LINE | 1) * LINE;
}

ShiftedGram::ShiftedGram(Workspace& workspace, Index most_rows, Index most_unknowns) {
    const Index columns = blocks_of(most_unknowns), stride = stride_for(columns);
    F_ = workspace.zeros<double>(blocks_of(most_rows) * stride);
    turned_ = workspace.zeros<double>(columns * stride);
    factor_ = workspace.zeros<double>(columns * stride);
    scaled_ = workspace.zeros<double>(columns * stride);
    inverse_ = workspace.zeros<double>(columns);
    least_ = workspace.zeros<double>(columns);
    small_ = workspace.zeros<double>(columns);
    set_unknowns(most_unknowns);
}

void ShiftedGram::set_unknowns(Index n) {
    n_ = n;
    tiled_ = blocks_of(n);
    stride_ = stride_for(tiled_);
}

// The system of F (rows, columns) in this memory; `lift`: small pivots are lifted.
GramSystem ShiftedGram::system(const double* F, Index rows, Index columns,
                               bool lift) const {
    return {F,       rows,    stride_,  columns,
            factor_, scaled_, inverse_, lift ? least_ : nullptr,
            stride_};
}

void ShiftedGram::solve(Index rows, double shift, bool by_rows, const double* r,
                        double* x) {
    if (by_rows && blocks_of(rows) < tiled_) return solve_by_rows(rows, shift, r, x);
    const GramSystem s = system(F_, rows, tiled_, shift < 1);
    begin_with_shift(s, shift, r, n_);
    solve_system(s, small_);
    for (Index j = 0; j < n_; ++j) x[j] = small_[j];
}

void ShiftedGram::solve(Index rows, const double* C, const double* r, double* x) {
    const GramSystem s = system(F_, rows, tiled_, true);
    begin_with_matrix(s, C, r, n_);
    solve_system(s, small_);
    for (Index j = 0; j < n_; ++j) x[j] = small_[j];
}

void ShiftedGram::begin(Index rows, double shift, const double* s) {
    begin_with_shift(system(F_, 0, blocks_of(rows), false), shift, s, rows);
}

void ShiftedGram::finish(Index rows, double shift, double* s) {
    solve_system(system(F_, 0, blocks_of(rows), shift < 1), small_);
    for (Index f = 0; f < rows; ++f) s[f] = small_[f];
}

// x = (r - F^T s) / shift with (shift I + F F^T) s = F r - shift f.
void ShiftedGram::solve_by_rows(Index rows, double shift, const double* r, double* x) {
    const Index columns = blocks_of(rows);
    for (Index e = rows * stride_; e < columns * stride_; ++e) F_[e] = 0;
    for (Index j = 0; j < n_; ++j) {
        double* turned = turned_ + j * stride_;
        for (Index f = 0; f < columns; f += BLOCK)
            for (int e = 0; e < BLOCK; ++e) turned[f + e] = F_[(f + e) * stride_ + j];
        turned[columns] = r[j];
    }
    for (Index f = 0; f < rows; ++f) small_[f] = -shift * F_[f * stride_ + tiled_];
    const GramSystem s = system(turned_, n_, columns, shift < 1);
    begin_with_shift(s, shift, small_, rows);
    solve_system(s, small_);
    double* mixture = turned_;
    mix_rows(small_, rows, F_, stride_, padded(n_), mixture);
    for (Index j = 0; j < n_; ++j) x[j] = (r[j] - mixture[j]) / shift;
}

}  // namespace shapefit
