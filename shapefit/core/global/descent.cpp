#include "descent.hpp"

#include "../pose/rotations.hpp"
#include "quaternions.hpp"

namespace shapefit {
namespace {

constexpr int MOST_STEPS = 100, MOST_TRIALS = 20;
constexpr double LONGEST = 0.5;    // radians in one step
constexpr double ENOUGH = 1e-4;    // share of the promised fall (Armijo)
constexpr double DAMPING = 1e-3;   // of the first curvature, beside its trace
constexpr double CURVED = 1e-10;   // share of |s| |y| from which s.y counts as positive

struct Point {
    double q[4], value, gradient[3];
};

double value_at(RotationObjective& objective, const double* q) {
    double R[9];
    rotation_of(q, R);
    return objective.value(R);
}

// H (3, 3) = (curvature + damping)^-1, by cofactors.
void invert_curvature(const double* curvature, double* H) {
    double A[9], C[9];
    const double trace = curvature[0] + curvature[4] + curvature[8];
    for (int e = 0; e < 9; ++e) A[e] = curvature[e] + (e % 4 == 0 ? DAMPING * trace : 0);
    const double determinant = find_cofactors(A, C);
    for (int e = 0; e < 9; ++e) H[e] = determinant > 0 ? C[e] / determinant : e % 4 == 0;
}

// H <- (I - s y^T / s.y) H (I - y s^T / s.y) + s s^T / s.y, where s.y is positive.
void update(const double* s, const double* y, double* H) {
    const double sy = inner3(s, y);
    if (!(sy > CURVED * root(inner3(s, s) * inner3(y, y)))) return;
    double Hy[3];
    for (int a = 0; a < 3; ++a) Hy[a] = inner3(H + 3 * a, y);
    const double more = (1 + inner3(y, Hy) / sy) / sy;
    for (int a = 0; a < 3; ++a)
        for (int b = 0; b < 3; ++b)
            H[3 * a + b] += more * s[a] * s[b] - (s[a] * Hy[b] + Hy[a] * s[b]) / sy;
}

// A step that keeps Armijo's rule; false where none does.
bool search_line(RotationObjective& objective, const Point& from, double* step, double slope,
                 Point& to) {
    for (int trial = 0; trial < MOST_TRIALS; ++trial) {
        for (int e = 0; e < 4; ++e) to.q[e] = from.q[e];
        turn_by(step, to.q);
        to.value = value_at(objective, to.q);
        if (to.value <= from.value + ENOUGH * slope) return true;
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
    for (int e = 0; e < 4; ++e) now.q[e] = q[e];
    now.value = value_at(objective, now.q);
    objective.derivatives(now.gradient, curvature);
    invert_curvature(curvature, H);
    for (int count = 0; count < MOST_STEPS; ++count) {
        double step[3];
        for (int a = 0; a < 3; ++a) step[a] = -inner3(H + 3 * a, now.gradient);
        const double length = root(inner3(step, step));
        if (length > LONGEST)
            for (double& s : step) s *= LONGEST / length;
        const double slope = inner3(step, now.gradient);
        if (!(-slope > share * now.value)) break;
        if (!search_line(objective, now, step, slope, next)) break;
        objective.derivatives(next.gradient, curvature);
        double change[3];
        for (int a = 0; a < 3; ++a) change[a] = next.gradient[a] - now.gradient[a];
        update(step, change, H);
        now = next;
    }
    for (int e = 0; e < 4; ++e) q[e] = now.q[e];
    return value_at(objective, q);
}

}  // namespace shapefit
