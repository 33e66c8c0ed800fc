// The translation eliminated: p weighted landmarks -> q = p_visible - 1 coordinates.
//
// The optimal T makes the weighted residual orthogonal to omega, so nothing is lost by turning the
// space of landmarks until omega is the last axis (a Householder reflection I - h h^T) and dropping
// that axis. For the quadratic losses this is the same as centring with weights omega^2.
#pragma once

#include "../algebra/workspace.hpp"

namespace shapefit::SHAPEFIT_LEVEL {

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
    void reduce(const double* x, const double* omega, double* out) const;

    // out = [y 0](I - h h^T) at the visible landmarks, 0 elsewhere: orthogonal to omega. out (p,).
    void expand(const double* y, double* out, long p) const;
};

}  // namespace shapefit::SHAPEFIT_LEVEL
