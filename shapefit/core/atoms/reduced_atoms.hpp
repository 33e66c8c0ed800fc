// Atoms and landmarks of an image without the translation: p weighted landmarks -> q =
// p_visible - 1 coordinates.
//
//     min_T ||Omega o (W - sum_i M_i B_i - T 1^T)||_F = ||w - sum_i M_i b_i||_F,
//     w = the first q columns of (W o omega)(I - h h^T),
//     b_i = those of (B_i o omega)(I - h h^T)
//
// The optimal T makes the weighted residual orthogonal to omega, so nothing is lost by
// turning the space of landmarks until omega is the last axis (a Householder reflection
// I - h h^T) and dropping that axis. For the quadratic losses this is the same as
// centring with weights omega^2. Code and comments elsewhere write B_i for b_i.
#pragma once

#include "../base/memory.hpp"
#include "../base/vectors.hpp"

namespace shapefit {

// The reduction of the landmarks and atoms of an image, which follows from its weights.
struct Reduction {
    Index visible_count = 0;  // visible landmarks; q = visible_count - 1
    Vector<Index> visible;    // (p,) their indices
    Vector<double> h;         // (p,) the reflection that maps omega to the last axis

    Reduction(Workspace& workspace, Index p)
        : visible(workspace.vector<Index>(p)), h(workspace.vector<double>(p)) {}

    // The number of coordinates, q.
    Index coordinates() const { return visible_count > 0 ? visible_count - 1 : 0; }

    // Set `visible` to the landmarks of positive weight in omega (p,), and h to their
    // reflection.
    void set_weights(Vector<const double> omega);

    // out = the first q entries of ((x - anchor) o omega)(I - h h^T); x and omega (p,).
    void reduce(const double* x, const double* omega, double* out,
                double anchor = 0) const;

    // Reduce both rows of the landmarks W (2, p), to rows of out `stride` apart. The
    // first visible landmark is the anchor, so that no digits are lost where they are
    // far from the origin, and landmarks on one point become exactly 0.
    void reduce_landmarks(Matrix<const double> W, const double* omega, double* out,
                          Index stride) const {
        for (int a = 0; a < 2; ++a)
            reduce(W[a].data, omega, out + a * stride, W[a][visible[0]]);
    }

    // out (p,) = [y 0](I - h h^T) at the visible landmarks, 0 elsewhere, for y (q,):
    // the transpose of `reduce`, orthogonal to omega.
    void expand(const double* y, double* out, Index p) const;
};

// Atoms with the atoms innermost, PADDING of them together, in the order in which they
// are read.
//
// Blocks of all atoms lie as six rows of `padded` numbers: entry (a, b) of block i is
// in row 3 a + b, so that loops over atoms vectorise. Zero atoms fill the last vector.
struct Planes {
    double* data = nullptr;  // (padded / PADDING, columns, 3, PADDING)
    Index columns = 0;
    Index padded_atoms = 0;

    // How many numbers there are in `data`.
    Index size() const { return 3 * columns * padded_atoms; }

    // Where entries (b, j) of atoms i, i + 1, ... up to the next multiple of PADDING
    // begin.
    double* at(int b, Index j, Index i) const {
        return data + ((i / PADDING * columns + j) * 3 + b) * PADDING + i % PADDING;
    }
};

// Copy the atoms B (k, 3, p) to an array in which the atoms are innermost, padded with
// zero atoms.
Planes make_planes(Tensor<const double> atoms, Workspace& workspace);

// N_i = Y B_i^T for all atoms: rows y0, y1 of Y (2, columns), N (6, padded).
void correlate(const Planes& B, const double* y0, const double* y1, double* N);

// out_i = <X, B_i> for all atoms: X (3, columns), out (padded,).
void find_inner_products(const Planes& B, const double* X, double* out);

// The reduced atoms of one image after another.
class ReducedAtoms {
  public:
    const Index k;  // atoms
    Planes planes;  // B (3, q, padded)
    Index row = 0;  // q, padded

    // Room for reductions of all atoms.
    ReducedAtoms(Workspace& workspace, const Planes& all, Index k)
        : k(k),
          planes{workspace.zeros<double>(all.size()), 0, all.padded_atoms},
          all_(all),
          rows_(workspace.zeros<double>(k * 3 * padded(all.columns))),
          is_copied_(workspace.zeros<bool>(k)) {}

    // The number of coordinates.
    Index q() const { return planes.columns; }

    // Set the atoms to the first q columns of (B_i o omega)(I - h h^T); returns their
    // largest Frobenius norm.
    double reduce(const double* omega, const Reduction& reduction);
    // B_i <- factor B_i.
    void scale(double factor);

    // B_i (3, row), with zeros from q on. Few atoms of an image are ever used: rows are
    // copied out of the planes when they are first asked for.
    const double* operator[](Index i) {
        return is_copied_[i] ? rows_ + i * 3 * row : copy_rows(i);
    }

  private:
    void resize(Index coordinates);
    const double* copy_rows(Index i);

    Planes all_;
    double* rows_;  // B (k, 3, row)
    bool* is_copied_;
};

// The reduced landmarks and atoms of one image after another, of the same atoms.
struct ReducedImage {
    ReducedImage(Workspace& workspace, Tensor<const double> all)
        : reduction(workspace, all.size[2]),
          atoms(workspace, make_planes(all, workspace), all.size[0]),
          w(workspace.zeros<double>(2 * padded(all.size[2]))) {}

    // Reduce landmarks W (2, p), and the atoms unless the weights are the last image's;
    // false where fewer than two landmarks are seen.
    bool reduce(Matrix<const double> W, Vector<const double> weights);

    Reduction reduction;
    ReducedAtoms atoms;
    double* w;                // (2, row), zero from q on
    double largest_norm = 0;  // of the atoms

  private:
    const double* last_weights_ = nullptr;
};

}  // namespace shapefit
