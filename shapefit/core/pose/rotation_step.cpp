#include "rotation_step.hpp"

namespace shapefit {
namespace {

// Radians.
constexpr double FIRST_RADIUS = 0.25, MAX_RADIUS = 1.0;
// The share of the promised fall from which on a step is taken, below which the region
// shrinks, and above which it grows.
constexpr double ACCEPT = 0.1, SHRINK = 0.25, GROW = 0.75;
// Beside the size of the terms of value and gradient, s (s tr P + ||D||): changes of
// the value below this are not judged.
constexpr double ROUNDING = 1e3 * 0x1p-52;
// And the norm of the gradient at the end.
constexpr double STATIONARY = 1e-11;
constexpr int MAX_STEPS = 200;

// The quadratic model of the squared residual f by a turn of the camera frame: f,
// gradient and Hessian.
struct Model {
    SquaredResidual residual;
    double g[3], H[9];
};

// X = R P R^T (3, 3) and E = D R^T (2, 3).
struct InCamera {
    InCamera(const ShapeMoments& moments, const double* R) {
        for (int b = 0; b < 3; ++b) {
            const double* r = R + 3 * b;
            const double Pr[3] = {inner3(moments.P, r), inner3(moments.P + 3, r),
                                  inner3(moments.P + 6, r)};
            for (int a = 0; a < 3; ++a) X[a][b] = inner3(R + 3 * a, Pr);
            for (int a = 0; a < 2; ++a) E[a][b] = inner3(moments.D + 3 * a, r);
        }
    }

    double X[3][3], E[2][3];
};

// The quadratic model of the squared residual f around R: f, gradient and Hessian, at
// the best scale s where that is free.
Model model_at(const ShapeMoments& moments, const Rotation& R) {
    const InCamera at(moments, R);
    const auto& X = at.X;
    const auto& E = at.E;
    const double overlap = E[0][0] + E[1][1], total = X[0][0] + X[1][1];
    double s = 1;
    if (moments.free_scale) s = total > 0 ? larger(overlap, 0) / total : 0;
    Model model;
    model.residual = {0.5 * s * s * total - s * overlap, s};
    model.g[0] = s * (E[1][2] - s * X[1][2]);
    model.g[1] = s * (s * X[0][2] - E[0][2]);
    model.g[2] = s * (E[0][1] - E[1][0]);
    double* H = model.H;
    H[0] = s * (E[1][1] + s * (X[2][2] - X[1][1]));
    H[4] = s * (E[0][0] + s * (X[2][2] - X[0][0]));
    H[8] = s * overlap;
    H[1] = s * (s * X[0][1] - 0.5 * (E[0][1] + E[1][0]));
    H[2] = -0.5 * s * (s * X[0][2] + E[0][2]);
    H[5] = -0.5 * s * (s * X[1][2] + E[1][2]);
    if (moments.free_scale && s > 0) {
        const double h[3] = {E[1][2] - 2 * s * X[1][2], 2 * s * X[0][2] - E[0][2],
                             E[0][1] - E[1][0]};
        for (int a = 0; a < 3; ++a)
            for (int b = a; b < 3; ++b) H[3 * a + b] -= h[a] * h[b] / total;
    }
    H[3] = H[1];
    H[6] = H[2];
    H[7] = H[5];
    return model;
}

// A step of the trust region, a turn in radians.
struct Step {
    double turn[3];
    double fall;   // of the model
    bool limited;  // by the region
};

// turn = -(H + shift I)^-1 g; false where the matrix is not positive definite, or the
// turn is longer than the radius.
bool solve_shifted(const Model& model, double shift, double radius, double* turn) {
    double A[9], C[9];
    for (int e = 0; e < 9; ++e) A[e] = model.H[e] + (e % 4 == 0 ? shift : 0);
    const double determinant = find_cofactors(A, C);
    if (!(A[0] > 0 && C[8] > 0 && determinant > 0)) return false;
    for (int a = 0; a < 3; ++a) turn[a] = -inner3(C + 3 * a, model.g) / determinant;
    return inner3(turn, turn) <= square(radius);
}

// The step -(H + shift I)^-1 g, no longer than the radius, and the fall of f that the
// model promises. The shift is 0 where that step is defined and short enough. Else it
// doubles from |g| / (2 radius) on until the step is both, as it always is from
// |g| / radius - (least eigenvalue of H) on. Where the numbers are not finite, the fall
// is not either.
Step find_step(const Model& model, double radius) {
    Step step{};
    const double first = root(inner3(model.g, model.g)) / (2 * radius);
    double shift = 0;
    while (is_finite(shift) && !solve_shifted(model, shift, radius, step.turn))
        shift = larger(2 * shift, first);
    double Ht[3];
    for (int a = 0; a < 3; ++a) Ht[a] = inner3(model.H + 3 * a, step.turn);
    step.fall = -inner3(model.g, step.turn) - 0.5 * inner3(step.turn, Ht);
    step.limited = shift > 0;
    return step;
}

}  // namespace

// Compiled as one function: its parts are short, and would pass a few numbers to each
// other through memory.
[[gnu::flatten]] SquaredResidual rotation_step(const ShapeMoments& moments,
                                               Rotation& R) {
    const double *P = moments.P, *D = moments.D;
    const double trace = P[0] + P[4] + P[8];
    const double norm = root(inner3(D, D) + inner3(D + 3, D + 3));
    double radius = FIRST_RADIUS;
    Model model = model_at(moments, R);
    for (int count = 0; count < MAX_STEPS; ++count) {
        const double s = model.residual.scale, size = s * (s * trace + norm);
        if (!(inner3(model.g, model.g) > square(STATIONARY * size))) break;
        const Step step = find_step(model, radius);
        const Rotation trial = R.turned(step.turn);
        const Model reached = model_at(moments, trial);
        const double slack = ROUNDING * size;
        const double fall = model.residual.value - reached.residual.value;
        const double ratio = (fall + slack) / (step.fall + slack);
        if (!(ratio >= SHRINK)) radius *= 0.25;
        else if (ratio > GROW && step.limited) radius = smaller(2 * radius, MAX_RADIUS);
        if (!(ratio > ACCEPT)) continue;
        model = reached;
        R = trial;
    }
    R.orthonormalise();
    return model.residual;
}

}  // namespace shapefit
