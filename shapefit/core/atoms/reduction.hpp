// The translation eliminated: p weighted landmarks -> q = p_visible - 1 coordinates.
//
// The optimal T makes the weighted residual orthogonal to omega, so nothing is lost by turning the
// space of landmarks until omega is the last axis (a Householder reflection I - h h^T) and dropping
// that axis. For the quadratic losses this is the same as centring with weights omega^2.
#pragma once

#include "../base/workspace.hpp"

namespace shapefit {

struct Reduction {
    long seen = 0;         // visible landmarks; q = seen - 1
    Vector<long> visible;  // (p,) their indices
    Vector<double> h;      // (p,) the reflection that maps omega to the last axis

    Reduction(Workspace& workspace, long p)
        : visible(workspace.vector<long>(p)), h(workspace.vector<double>(p)) {}

    long coordinates() const { return seen > 0 ? seen - 1 : 0; }

    // Landmarks of positive weight in omega (p,), and their reflection.
    void find(Vector<const double> omega);

    // out = the first q entries of (x o omega)(I - h h^T); x and omega (p,).
    void reduce(const double* x, const double* omega, double* out) const {
        reduce(x, 0, omega, out);
    }

    // Landmarks W (2, p) likewise, in rows `stride` apart: from the first one that is seen, so that
    // no digits are lost where they are far from the origin, and those on one point are exactly 0.
    void reduce_landmarks(Matrix<const double> W, const double* omega, double* out, long stride) const {
        for (int a = 0; a < 2; ++a)
            reduce(W[a].data, W[a][visible[0]], omega, out + a * stride);
    }

    // out = [y 0](I - h h^T) at the visible landmarks, 0 elsewhere: orthogonal to omega. out (p,).
    void expand(const double* y, double* out, long p) const;

  private:
    void reduce(const double* x, double anchor, const double* omega, double* out) const;
};

}  // namespace shapefit
