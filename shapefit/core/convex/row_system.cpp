#include "row_system.hpp"

namespace shapefit {
namespace {

// Below so many unknowns it is quicker to write the rows.
constexpr Index MIN_UNKNOWNS = 150;

}  // namespace

RowSystem::RowSystem(Workspace& workspace, Index padded_atoms)
    : capacity_(padded_atoms),
      products_(workspace, padded_atoms),
      order_(workspace.zeros<Index>(capacity_)),
      atom_(workspace.zeros<Index>(capacity_)),
      directions_(workspace.zeros<double>(42 * capacity_)),
      product_(workspace.zeros<double>(9 * capacity_)),
      turned_(workspace.zeros<double>(6 * capacity_)),
      s_(workspace.zeros<double>(6 * capacity_)) {}

bool RowSystem::solve(const ActiveBlocks& active, double shift, const double* r,
                      double* x, ReducedAtoms& atoms, ShiftedGram& gram) {
    if (gram.unknowns() < MIN_UNKNOWNS) return false;
    sort_blocks(active);
    if (rows() >= gram.unknowns() || !products_.make(atoms, atom_, blocks_))
        return false;
    copy_directions(active);
    find_right_side(shift, r, atoms);
    gram.begin(rows(), shift, s_);
    for (Index c = 0; c < blocks_; ++c) add_products_of(c, gram);
    gram.finish(rows(), shift, s_);
    expand(shift, r, x, atoms);
    return true;
}

// Set the order of the active blocks, those of six directions first: directions 4 and 5
// are of the first blocks then.
void RowSystem::sort_blocks(const ActiveBlocks& active) {
    blocks_ = active.count;
    wide_ = 0;
    for (Index c = 0; c < blocks_; ++c) wide_ += active.directions(c) == 6;
    Index next_wide = 0, next_narrow = wide_;
    for (Index c = 0; c < blocks_; ++c)
        order_[active.directions(c) == 6 ? next_wide++ : next_narrow++] = c;
    for (Index d = 0; d < blocks_; ++d) atom_[d] = active.index[order_[d]];
    for (int t = 1; t < 6; ++t) first_[t] = first_[t - 1] + blocks_with(t - 1);
}

// Copy the directions of the active blocks in the order of the system.
void RowSystem::copy_directions(const ActiveBlocks& active) {
    for (int t = 0; t < 6; ++t)
        for (int e = 0; e < 7; ++e) {
            const double* from = active.entry(t, e);
            double* to = entry(t, e);
            const Index count = blocks_with(t);
            for (Index d = 0; d < count; ++d) to[d] = from[order_[d]];
            for (Index d = count; d < padded(count); ++d) to[d] = 0;
        }
}

// s_ = F r - shift f.
void RowSystem::find_right_side(double shift, const double* r, ReducedAtoms& atoms) {
    const Index q = atoms.q();
    for (Index d = 0; d < blocks_; ++d) {
        const double* B = atoms[atom_[d]];
        double along[6];  // r B_d^T
        for (int e = 0; e < 6; ++e)
            along[e] = dot(r + e / 3 * q, B + e % 3 * atoms.row, q);
        for (int t = 0; t < 6 && d < blocks_with(t); ++t) {
            double sum = -shift * entry(t, 6)[d];
            for (int e = 0; e < 6; ++e) sum += entry(t, e)[d] * along[e];
            s_[first_[t] + d] = sum;
        }
    }
}

// Add the rows of F F^T that belong to block c, from the diagonal on.
void RowSystem::add_products_of(Index c, ShiftedGram& gram) {
    const double* products = products_.with(atom_[c]);
    for (int e = 0; e < 9; ++e) {
        double* product = product_ + e * capacity_;
        for (Index d = 0; d < blocks_; ++d)
            product[d] = products[e * products_.places() + products_.place(atom_[d])];
        for (Index d = blocks_; d < padded(blocks_); ++d) product[d] = 0;
    }
    for (int t = 0; t < 6 && c < blocks_with(t); ++t) {
        turn_products(t, c);
        double* row = gram.factor_row(first_[t] + c);
        for (int u = t; u < 6; ++u)
            add_products_with(u, u == t ? c : 0, row + first_[u]);
    }
}

// row_d += <T_tc, T_ud (B_d B_c^T)> for direction u of all blocks d, with T_tc B_c
// B_d^T in turned_: a vector of blocks at a time, from the one that holds block `first`
// on. Directions are 0 beyond the last block, and nobody reads what a row has left of
// the diagonal.
void RowSystem::add_products_with(int u, Index first, double* row) const {
    const double* T = entry(u, 0);
    for (Index d = first / WIDTH * WIDTH; d < blocks_with(u); d += WIDTH) {
        Doubles sum = load(row + d);
        for (int e = 0; e < 6; ++e)
            sum += load(turned_ + e * capacity_ + d) * load(T + e * capacity_ + d);
        store(row + d, sum);
    }
}

// turned_ = T_tc B_c B_d^T for all d.
void RowSystem::turn_products(int t, Index c) {
    const Index n = capacity_;
    for (int a = 0; a < 2; ++a) {
        const double x = entry(t, 3 * a)[c], y = entry(t, 3 * a + 1)[c],
                     z = entry(t, 3 * a + 2)[c];
        for (int b = 0; b < 3; ++b) {
            double* out = turned_ + (3 * a + b) * n;
            const double* G = product_ + b * n;
            for (Index d = 0; d < blocks_; d += WIDTH)
                store(out + d, x * load(G + d) + y * load(G + 3 * n + d) +
                                   z * load(G + 6 * n + d));
        }
    }
}

// x = (r - F^T s) / shift.
void RowSystem::expand(double shift, const double* r, double* x,
                       ReducedAtoms& atoms) const {
    const Index q = atoms.q();
    for (Index j = 0; j < 2 * q; ++j) x[j] = r[j];
    for (Index d = 0; d < blocks_; ++d) {
        double M[6] = {};
        for (int t = 0; t < 6 && d < blocks_with(t); ++t)
            for (int e = 0; e < 6; ++e) M[e] += s_[first_[t] + d] * entry(t, e)[d];
        subtract_shape(M, atoms[atom_[d]], atoms.row, x, q);
    }
    for (Index j = 0; j < 2 * q; ++j) x[j] /= shift;
}

}  // namespace shapefit
