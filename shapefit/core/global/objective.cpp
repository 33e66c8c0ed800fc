#include "objective.hpp"

namespace shapefit {

Rotation rotation_of(const double* q) {
    Rotation R;
    bilinear_rows(q, q, R);
    R.complete();
    return R;
}

void quaternion_of(const double* R, double* q) {
    // 4 q_e^2 for each e; the largest of them is at least 1
    const double square[4] = {1 + R[0] + R[4] + R[8], 1 + R[0] - R[4] - R[8],
                              1 - R[0] + R[4] - R[8], 1 - R[0] - R[4] + R[8]};
    int most = 0;
    for (int e = 1; e < 4; ++e)
        if (square[e] > square[most]) most = e;
    const double products[4][4] = {
        {square[0], R[7] - R[5], R[2] - R[6], R[3] - R[1]},
        {R[7] - R[5], square[1], R[1] + R[3], R[2] + R[6]},
        {R[2] - R[6], R[1] + R[3], square[2], R[5] + R[7]},
        {R[3] - R[1], R[2] + R[6], R[5] + R[7], square[3]},
    };
    for (int e = 0; e < 4; ++e) q[e] = products[most][e];
    make_unit(q);
}

RotationObjective::RotationObjective(Workspace& workspace, const SearchProblem& problem)
    : problem(problem),
      image(workspace, problem.atoms),
      step_(workspace, image.atoms, problem.atoms.size[2]),
      shape_(workspace.zeros<double>(3 * padded(problem.atoms.size[2]))) {}

bool RotationObjective::set_image(Index at) {
    if (!image.reduce(problem.landmarks[at], problem.weights[at])) return false;
    square = dot_padded(image.w, image.w, 2 * atoms.row);
    lam = problem.lam[at];
    step_.set_program(image.w, lam, false);
    step_.set.clear();
    return true;
}

double RotationObjective::value(const Rotation& R) {
    check_interrupt();
    R_ = R;
    return step_.minimise_at(R_);
}

// With X = R S and y = (Y, 0): d/dturn of <-Y, turn x X> is -sum_j X_j x y_j.
void RotationObjective::derivatives(double* gradient, double* curvature) {
    step_.mix(shape_);
    const Index row = atoms.row;
    const double *u = step_.residual(), *v = u + row;
    double P[9], turned[9], moment[6];
    find_gram(shape_, row, P);
    for (int b = 0; b < 3; ++b) {
        const double* S = shape_ + b * row;
        moment[b] = dot_padded(S, u, row);      // S u^T
        moment[3 + b] = dot_padded(S, v, row);  // S v^T
    }
    // X X^T = R P R^T, X u^T = R (S u^T)
    double XX[9], Xu[3], Xv[3];
    for (int a = 0; a < 3; ++a) {
        for (int b = 0; b < 3; ++b) turned[3 * a + b] = inner3(R_ + 3 * a, P + 3 * b);
        Xu[a] = inner3(R_ + 3 * a, moment);
        Xv[a] = inner3(R_ + 3 * a, moment + 3);
    }
    for (int a = 0; a < 3; ++a)
        for (int b = 0; b < 3; ++b) XX[3 * a + b] = inner3(turned + 3 * a, R_ + 3 * b);
    gradient[0] = Xv[2];
    gradient[1] = -Xu[2];
    gradient[2] = Xu[1] - Xv[0];
    // the rows of the derivative of the projection are (0, z, -y) and (-z, 0, x)
    curvature[0] = XX[8];
    curvature[4] = XX[8];
    curvature[8] = XX[0] + XX[4];
    curvature[1] = curvature[3] = 0;
    curvature[2] = curvature[6] = -XX[2];
    curvature[5] = curvature[7] = -XX[5];
}

namespace {

constexpr int MAX_STEPS = 100, MAX_TRIALS = 20;
constexpr double MAX_TURN = 0.5;  // radians in one step
constexpr double ARMIJO = 1e-4;   // share of the promised fall (Armijo)
constexpr double DAMPING = 1e-3;  // of the first curvature, beside its trace
constexpr double MIN_CURVATURE =
    1e-10;  // share of |s| |y| from which s.y counts as positive

// A rotation, v there and its gradient.
struct Point {
    Rotation R;
    double value, gradient[3];
};

// H (3, 3) = (curvature + DAMPING tr(curvature) I)^-1, by cofactors.
void invert_curvature(const double* curvature, double* H) {
    double A[9], C[9];
    const double trace = curvature[0] + curvature[4] + curvature[8];
    for (int e = 0; e < 9; ++e)
        A[e] = curvature[e] + (e % 4 == 0 ? DAMPING * trace : 0);
    const double determinant = find_cofactors(A, C);
    for (int e = 0; e < 9; ++e)
        H[e] = determinant > 0 ? C[e] / determinant : e % 4 == 0;
}

// Update the inverse Hessian H after a step s that changed the gradient by y (BFGS): H
// <- (I - s y^T / s.y) H (I - y s^T / s.y) + s s^T / s.y, where s.y is positive.
void update_inverse_hessian(const double* s, const double* y, double* H) {
    const double sy = inner3(s, y);
    if (!(sy > MIN_CURVATURE * root(inner3(s, s) * inner3(y, y)))) return;
    double Hy[3];
    for (int a = 0; a < 3; ++a) Hy[a] = inner3(H + 3 * a, y);
    const double more = (1 + inner3(y, Hy) / sy) / sy;
    for (int a = 0; a < 3; ++a)
        for (int b = 0; b < 3; ++b)
            H[3 * a + b] += more * s[a] * s[b] - (s[a] * Hy[b] + Hy[a] * s[b]) / sy;
}

// Shorten `step` until v falls by Armijo's rule, and set `to` to the point it leads to;
// false where no such step is found. `slope` < 0 is what the gradient predicts
// for the change of v.
bool search_line(RotationObjective& objective, const Point& from, double* step,
                 double slope, Point& to) {
    for (int trial = 0; trial < MAX_TRIALS; ++trial) {
        to.R = from.R.turned(step);
        to.value = objective.value(to.R);
        if (to.value <= from.value + ARMIJO * slope) return true;
        // the minimum of the parabola through both values with the slope
        const double bend = 2 * (to.value - from.value - slope);
        const double share = smaller(larger(-slope / bend, 0.1), 0.5);
        for (int a = 0; a < 3; ++a) step[a] *= share;
        slope *= share;
    }
    return false;
}

}  // namespace

double descend(RotationObjective& objective, double* q, double share) {
    Point now, next;
    double curvature[9], H[9];
    now.R = rotation_of(q);
    now.value = objective.value(now.R);
    objective.derivatives(now.gradient, curvature);
    invert_curvature(curvature, H);
    for (int count = 0; count < MAX_STEPS; ++count) {
        double step[3];
        for (int a = 0; a < 3; ++a) step[a] = -inner3(H + 3 * a, now.gradient);
        const double length = root(inner3(step, step));
        if (length > MAX_TURN)
            for (double& s : step) s *= MAX_TURN / length;
        const double slope = inner3(step, now.gradient);
        if (!(-slope > share * now.value)) break;
        if (!search_line(objective, now, step, slope, next)) break;
        objective.derivatives(next.gradient, curvature);
        double change[3];
        for (int a = 0; a < 3; ++a) change[a] = next.gradient[a] - now.gradient[a];
        update_inverse_hessian(step, change, H);
        now = next;
    }
    quaternion_of(now.R, q);
    return objective.value(rotation_of(q));
}

}  // namespace shapefit
