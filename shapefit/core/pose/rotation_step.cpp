#include "rotation_step.hpp"

namespace shapefit {
namespace {

constexpr double HALF = 0.70710678118654752440;  // sqrt(1/2)
// The rules of Absil, Baker and Gallivan 2007, with the constants of Manopt.
constexpr double LARGEST_RADIUS = 1.41421356237309504880;
constexpr double FIRST_RADIUS = LARGEST_RADIUS / 8;
constexpr double ACCEPT = 0.1, SHRINK = 0.25, GROW = 0.75;
constexpr double LINEAR = 0.1;  // tCG stops where the residual is |g| min(|g|, LINEAR)
constexpr double SHORT = 0.1;   // length of a step that needs no caution
// Beside the size of the terms of value and gradient, s (s tr P + ||D||):
constexpr double ROUNDING =
    1e3 * 0x1p-52;                    // changes of the value below this are not judged
constexpr double STATIONARY = 1e-11;  // norm of the gradient at the end
constexpr int MOST_STEPS = 200;

// The step -H^-1 g, by cofactors, and the fall of the model; false where H is not
// positive definite or the step not short enough to end where conjugate gradients
// would.
bool newton_step(const double* g, const double* H, double radius, double* step,
                 double& fall) {
    double C[9];
    const double det = find_cofactors(H, C);
    if (!(H[0] > 0 && C[8] > 0 && det > 0)) return false;
    for (int a = 0; a < 3; ++a) step[a] = -inner3(C + 3 * a, g) / det;
    fall = -0.5 * inner3(g, step);
    return inner3(step, step) < square(smaller(radius, SHORT));
}

void mirror(double* H) {
    H[3] = H[1];
    H[6] = H[2];
    H[7] = H[5];
}

// A step within a trust region: whether it ends at the edge, and the fall that the
// model promises.
struct TrustedStep {
    bool at_edge;
    double fall;
};

// The residual at R, its Riemannian gradient g (3,) and Hessian H (3, 3).
//
// The Hessian is Proj(s^2 U P - Lambda U) with Lambda = sym(Rbar G^T) and G = s (s Rbar
// P - D); a free s takes its share off, h h^T / tr(Rbar P Rbar^T) with h the derivative
// of the gradient by s (Schur complement).
SquaredResidual model_at(const ShapeMoments& moments, const Rotation& rotation,
                         double* g, double* H) {
    const double* R = rotation;
    const double *P = moments.P, *D = moments.D;
    double PR[3][3], DR[2][3];  // P and D in the frame of R: r_a P r_b, D_a r_b
    for (int b = 0; b < 3; ++b) {
        const double* r = R + 3 * b;
        const double image[3] = {inner3(P, r), inner3(P + 3, r), inner3(P + 6, r)};
        for (int a = 0; a < 3; ++a) PR[a][b] = inner3(R + 3 * a, image);
        for (int a = 0; a < 2; ++a) DR[a][b] = inner3(D + 3 * a, r);
    }
    const double overlap = DR[0][0] + DR[1][1], total = PR[0][0] + PR[1][1];
    double s = 1;
    if (moments.free_scale) s = total > 0 ? larger(overlap, 0) / total : 0;
    const double turn = HALF * (DR[0][1] - DR[1][0]);
    g[0] = s * (s * PR[0][2] - DR[0][2]);
    g[1] = s * (s * PR[1][2] - DR[1][2]);
    g[2] = s * turn;
    H[0] = s * (s * (PR[2][2] - PR[0][0]) + DR[0][0]);
    H[4] = s * (s * (PR[2][2] - PR[1][1]) + DR[1][1]);
    H[8] = 0.5 * s * overlap;
    H[1] = s * (0.5 * (DR[0][1] + DR[1][0]) - s * PR[0][1]);
    H[2] = -s * s * HALF * PR[1][2];
    H[5] = s * s * HALF * PR[0][2];
    if (moments.free_scale && s > 0) {
        const double h[3] = {2 * s * PR[0][2] - DR[0][2], 2 * s * PR[1][2] - DR[1][2],
                             turn};
        for (int a = 0; a < 3; ++a)
            for (int b = a; b < 3; ++b) H[3 * a + b] -= h[a] * h[b] / total;
    }
    mirror(H);
    return {0.5 * s * s * total - s * overlap, s};
}

// Steihaug's conjugate gradients for min g x + 1/2 x H x over |x| <= radius; step x
// (3,).
TrustedStep truncated_cg(const double* g, const double* H, double radius,
                         double* step) {
    double r[3], d[3], Hd[3];
    for (int a = 0; a < 3; ++a) {
        step[a] = 0;
        r[a] = g[a];
        d[a] = -g[a];
    }
    double rr = inner3(g, g), xx = 0, xd = 0, dd = rr, fall = 0;
    const double goal = root(rr) * smaller(root(rr), LINEAR);
    bool at_edge = false;
    for (int count = 0; count < 3; ++count) {
        for (int a = 0; a < 3; ++a) Hd[a] = inner3(H + 3 * a, d);
        const double curvature = inner3(d, Hd), slope = inner3(d, r);
        double length = curvature > 0 ? rr / curvature : 0;
        at_edge =
            curvature <= 0 || xx + length * (2 * xd + length * dd) >= radius * radius;
        if (at_edge) length = (root(xd * xd + dd * (radius * radius - xx)) - xd) / dd;
        for (int a = 0; a < 3; ++a) {
            step[a] += length * d[a];
            r[a] += length * Hd[a];
        }
        fall -= length * (slope + 0.5 * length * curvature);
        const double before = rr;
        rr = inner3(r, r);
        if (at_edge || rr <= goal * goal) break;
        const double ratio = rr / before;
        xx += length * (2 * xd + length * dd);
        xd = ratio * (xd + length * dd);
        dd = rr + ratio * ratio * dd;
        for (int a = 0; a < 3; ++a) d[a] = ratio * d[a] - r[a];
    }
    return {at_edge, fall};
}

// Orthonormalise Rbar + step, step (3,) in the basis of the tangent space, and complete
// it.
void retract(const double* R, const double* step, Rotation& trial) {
    const double turn = HALF * step[2];
    double* to = trial;
    for (int b = 0; b < 3; ++b) {
        to[b] = R[b] + step[0] * R[6 + b] - turn * R[3 + b];
        to[3 + b] = R[3 + b] + step[1] * R[6 + b] + turn * R[b];
    }
    trial.orthonormalise();
}

}  // namespace

// As one function: its parts are short, and hand each other a few numbers through
// memory else.
[[gnu::flatten]] SquaredResidual rotation_step(const ShapeMoments& moments,
                                               Rotation& R) {
    const double *P = moments.P, *D = moments.D;
    Rotation trial;
    double g[3], H[9], step[3], trial_g[3], trial_H[9];
    const double trace = P[0] + P[4] + P[8];
    const double norm = root(inner3(D, D) + inner3(D + 3, D + 3));
    double radius = FIRST_RADIUS;
    SquaredResidual residual = model_at(moments, R, g, H);
    for (int count = 0; count < MOST_STEPS; ++count) {
        const double size = residual.scale * (residual.scale * trace + norm);
        if (inner3(g, g) <= square(STATIONARY * size)) break;
        TrustedStep trusted{false, 0};
        if (!newton_step(g, H, radius, step, trusted.fall))
            trusted = truncated_cg(g, H, radius, step);
        retract(R, step, trial);
        const SquaredResidual reached = model_at(moments, trial, trial_g, trial_H);
        const double slack = ROUNDING * size;
        const double ratio =
            (residual.value - reached.value + slack) / (trusted.fall + slack);
        if (!(ratio >= SHRINK)) radius *= 0.25;
        else if (ratio > GROW && trusted.at_edge)
            radius = smaller(2 * radius, LARGEST_RADIUS);
        if (!(ratio > ACCEPT)) continue;
        residual = reached;
        R = trial;
        for (int e = 0; e < 9; ++e) H[e] = trial_H[e];
        for (int a = 0; a < 3; ++a) g[a] = trial_g[a];
    }
    return residual;
}

}  // namespace shapefit
