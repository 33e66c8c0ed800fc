#include "normal_equations.hpp"

namespace shapefit {
namespace {

// Columns of r and of the first coefficient, which begins a vector.
constexpr int RESIDUAL = POSE, FIRST = 8;
// Share of a column's square outside the span of the others at which it depends on
// them.
constexpr double DEPENDENT = 1e-14;
// By which a coefficient that is 0 may still pull, as a share of the largest h.
constexpr double SLACK = 1e-10;

}  // namespace

NormalEquations::NormalEquations(Workspace& workspace, const Shapes& shapes)
    : shapes_(shapes),
      width_(FIRST + shapes.filled),
      J_(workspace.matrix<double>(2 * shapes.p, width_)),
      H_(workspace.matrix<double>(width_, width_)),
      root_of_weight_(workspace.zeros<double>(padded(shapes.p))),
      inverse_depth_(workspace.zeros<double>(padded(shapes.p))),
      C_(workspace.matrix<double>(POSE, shapes.filled)),
      Q_(workspace.matrix<double>(shapes.filled, shapes.filled)),
      h_(workspace.zeros<double>(shapes.filled)),
      change_(workspace.zeros<double>(shapes.filled)),
      score_(workspace.zeros<double>(shapes.filled)),
      ones_(workspace.zeros<double>(shapes.filled)),
      set_(workspace, shapes.filled) {
    for (Index i = 0; i < shapes.filled; ++i) ones_[i] = 1;
}

void NormalEquations::linearise(const Observations& observations, const Position& here,
                                double softness) {
    find_depths_and_weights(observations, here, softness);
    for (Index j = 0; j < observations.count; ++j)
        for (int a = 0; a < 2; ++a)
            fill_row(observations, here, j, a, J_[2 * j + a].data);
    sum_squares(2 * observations.count);
}

void NormalEquations::step(double damping, const Unknowns& at, Unknowns& next) {
    const Index filled = shapes_.filled;
    eliminate_pose(damping);
    find_matrix(damping);
    find_linear_term(at.c);
    for (Index i = 0; i < filled; ++i) next.c[i] = at.c[i];
    minimise_coefficients(next.c);
    for (Index i = 0; i < filled; ++i) change_[i] = next.c[i] - at.c[i];
    double pose[POSE];
    substitute_pose(pose);
    next.R = at.R.turned(pose);
    for (int a = 0; a < 3; ++a) next.t[a] = at.t[a] + pose[3 + a];
}

// Set the root of the weight that the robust loss gives each landmark, and 1 / its
// depth.
void NormalEquations::find_depths_and_weights(const Observations& observations,
                                              const Position& here, double softness) {
    const double inverse = 1 / square(softness);
    double* __restrict root_of_weight = root_of_weight_;
    double* __restrict inverse_depth = inverse_depth_;
    for (Index j = 0; j < observations.filled; ++j) {
        const double size = square(here.r[0][j]) + square(here.r[1][j]);
        root_of_weight[j] = 1 / root(1 + size * inverse);
        inverse_depth[j] = 1 / (observations.sign * here.X[2][j]);
    }
}

// Set the row of J for coordinate a of landmark j, in the columns (omega, tau, r, -,
// c).
void NormalEquations::fill_row(const Observations& observations, const Position& here,
                               Index j, int a, double* __restrict row) const {
    const double root_of_weight = root_of_weight_[j];
    const double inverse_depth = inverse_depth_[j];
    const double along =
        root_of_weight * observations.omega[j] * observations.focal[a] * inverse_depth;
    double in_camera[3] = {};  // the derivative in X_j
    in_camera[a] = along;
    in_camera[2] = -along * here.X[a][j] * (observations.sign * inverse_depth);
    const double turned[3] = {here.turned[0][j], here.turned[1][j], here.turned[2][j]};
    cross(turned, in_camera, row);
    for (int b = 0; b < 3; ++b) row[3 + b] = in_camera[b];
    row[RESIDUAL] = root_of_weight * here.r[a][j];
    double u[3];  // in the frame of the atoms
    const double* R = here.at.R;
    for (int b = 0; b < 3; ++b)
        u[b] = in_camera[0] * R[b] + in_camera[1] * R[3 + b] + in_camera[2] * R[6 + b];
    const Index filled = shapes_.filled;
    const double* atoms = shapes_.by_landmark[observations.index[j]].data;
    for (Index i = 0; i < filled; ++i)
        row[FIRST + i] =
            u[0] * atoms[i] + u[1] * atoms[filled + i] + u[2] * atoms[2 * filled + i];
}

// Set H = J^T J over so many rows, from the diagonal on, in blocks of 8 x WIDTH that
// are summed in registers: as many sums as hide the latency of one.
void NormalEquations::sum_squares(Index rows) {
    for (Index i = 0; i < width_; i += 8)
        for (Index j = i; j < width_; j += WIDTH) {
            Doubles total[8] = {};
            for (Index row = 0; row < rows; ++row) {
                const double* left = J_.data + row * width_ + i;
                const Doubles right = load(J_.data + row * width_ + j);
                for (int e = 0; e < 8; ++e) total[e] += left[e] * right;
            }
            for (int e = 0; e < 8; ++e) store(H_[i + e].data + j, total[e]);
        }
}

// Set L, C and g of the header's equations, row after row.
void NormalEquations::eliminate_pose(double damping) {
    const Index filled = shapes_.filled;
    for (int e = 0; e < POSE; ++e) {
        double* __restrict row = C_[e].data;
        for (Index i = 0; i < filled; ++i) row[i] = H_[e][FIRST + i];
        g_[e] = -H_[e][RESIDUAL];
        double pivot = H_[e][e] * (1 + damping);
        for (int f = 0; f < e; ++f) {
            double overlap = H_[f][e];
            for (int b = 0; b < f; ++b) overlap -= L_[e][b] * L_[f][b];
            L_[e][f] = overlap / L_[f][f];
            g_[e] -= L_[e][f] * g_[f];
            pivot -= square(L_[e][f]);
            add_to(row, -L_[e][f], C_[f].data, filled);
        }
        L_[e][e] = root(larger(pivot, TINY));
        const double inverse = 1 / L_[e][e];
        g_[e] *= inverse;
        for (Index i = 0; i < filled; ++i) row[i] *= inverse;
    }
}

// Set the matrix Q of the quadratic program in c, the pose eliminated.
void NormalEquations::find_matrix(double damping) {
    const Index filled = shapes_.filled;
    const double* C[POSE];
    for (int e = 0; e < POSE; ++e) C[e] = C_[e].data;
    for (Index i = 0; i < filled; ++i) {
        double* __restrict Q = Q_[i].data;
        const double* row = H_[FIRST + i].data + FIRST;
        const double c0 = C[0][i], c1 = C[1][i], c2 = C[2][i];
        const double c3 = C[3][i], c4 = C[4][i], c5 = C[5][i];
        const Index from = i / 8 * 8;  // blocks below the diagonal are not in H
        for (Index j = from; j < filled; ++j)
            Q[j] = row[j] - c0 * C[0][j] - c1 * C[1][j] - c2 * C[2][j] - c3 * C[3][j] -
                   c4 * C[4][j] - c5 * C[5][j];
        Q[i] += damping * row[i] + shapes_.ridge;
        for (Index j = 0; j < from; ++j) Q[j] = Q_[j][i];
    }
}

// Set the linear term h of the quadratic program in c, the pose eliminated.
void NormalEquations::find_linear_term(const double* c) {
    const Index filled = shapes_.filled;
    for (Index i = 0; i < filled; ++i) {
        double h = shapes_.ridge * (shapes_.prior[i] - c[i]) - H_[RESIDUAL][FIRST + i];
        for (int e = 0; e < POSE; ++e) h -= C_[e][i] * g_[e];
        h_[i] = h + dot(Q_[i].data, c, filled);
    }
}

// Overwrite a feasible x (k',) by the solution of the quadratic program in c.
void NormalEquations::minimise_coefficients(double* x) {
    const Index filled = shapes_.filled;
    double largest = 0;
    set_.clear();
    for (Index i = 0; i < filled; ++i) {
        largest = larger(magnitude(h_[i]), largest);
        if (x[i] > 0) set_.use(i, x[i], 1);
    }
    DenseTerms<true> terms{Q_.data, h_,    shapes_.gauge.data, ones_, SLACK * largest,
                           score_,  filled};
    minimise(terms, set_, DEPENDENT, 10 * filled + 100);
    set_.write({x, {filled}});
}

// pose (6,) = d_p, by back substitution in L^T d_p = g - C d_c.
void NormalEquations::substitute_pose(double* pose) const {
    for (int e = POSE - 1; e >= 0; --e) {
        double value = g_[e] - dot(C_[e].data, change_, shapes_.filled);
        for (int f = e + 1; f < POSE; ++f) value -= L_[f][e] * pose[f];
        pose[e] = value / L_[e][e];
    }
}

}  // namespace shapefit
