// Least squares on a sphere: the secular equation and its largest root.
//
// argmin y^T G y - 2 g^T y over ||y|| = radius, for symmetric G (m, m), is where
// (G + multiplier I) y = g and G + multiplier I is positive semidefinite: at the largest root of
//
//     sum_i (t_i / (mu_i + multiplier))^2 = radius^2,      G = V^T diag(mu) V, t = V g.
//
// 1 / ||y|| is a concave function of the multiplier right of the last pole: Newton's method from
// the left of the root never overshoots. Where g has no part along the least eigenvalue the pole
// may be none, and the root may lie left of it: then the multiplier is the pole and the
// eigenvector fills up y (the hard case). Source: Gander 1981; More and Sorensen 1983.
#pragma once

#include "../base/workspace.hpp"

namespace shapefit {

// Memory for problems of up to m unknowns.
struct SphereSpace {
    double *A, *V;             // (m, m)
    double *mu, *above, *t, *z;  // (m,)
};

SphereSpace sphere_space(Workspace& workspace, long m);

// Overwrite y (m,) with the minimiser, of two the one nearer to what it was; the multiplier.
double minimise_on_sphere(Matrix<const double> G, Vector<const double> g, double radius,
                          Vector<double> y, const SphereSpace& space);

// The same with memory of its own.
double minimise_on_sphere_alone(Matrix<const double> G, Vector<const double> g, double radius,
                                Vector<double> y);

}  // namespace shapefit
