// Refinement of camera and shape under the full perspective projection.
#include "../atoms/scaled_coefficients.hpp"
#include "../base/registry.hpp"
#include "../base/lanes.hpp"
#include "../base/vectors.hpp"
#include "../base/memory.hpp"
#include "../shared/data.hpp"

namespace shapefit {

// What the refinement under perspective reads and writes, as Python lays it out.

// min over R, t, c >= 0 of sum_j s^2/2 log(1 + |r_j|^2 / s^2) + ridge/2 |c - prior|^2, n images.
struct PerspectiveData {
    Arguments& from;
    Tensor<const double> landmarks = from("landmarks", "n 2 p");  // w
    Matrix<const double> weights = from("weights", "n p");  // Omega, 0 = hidden
    Tensor<const double> atoms = from("atoms", "k 3 p");  // B
    Vector<const double> prior = from("prior", "k");
    Matrix<const double> focal = from("focal", "n 2");
    Matrix<const double> centre = from("centre", "n 2");
    double sign = from("sign");  // of the depth: 1 where z points away from the camera, else -1
    double ridge = from("ridge");
    double softness = from("softness");  // s at the end
    long most_rounds = from("max_rounds");
    Tensor<double> rotation = from("rotation", "n 3 3");  // R, the start, overwritten
    Matrix<double> translation = from("translation", "n 3");  // t, likewise
    Matrix<double> coefficients = from("coefficients", "n k");  // c, likewise
    Vector<double> objective = from("objective", "n");
    Vector<int64_t> rounds = from("rounds", "n");
    Vector<int64_t> status = from("status", "n");
};

// One image, its points X and residuals r.
struct ProjectionData {
    Arguments& from;
    PerspectiveData image{from};
    Matrix<double> X = from("X", "3 p");
    Matrix<double> r = from("r", "2 p");
};

// One shape seen by a camera, and how far that is from the landmarks.
//
//     X = R sum_i c_i B_i + t,    r_j = omega_j (centre + focal X_xy / (sign X_z) - w_j)

// The atoms of all images, landmark after landmark, and atoms of zeros that fill up vectors: their
// coefficients stay 0.
struct Shapes {
    Tensor<const double> atoms;   // (k, 3, p)
    Tensor<double> by_landmark;   // (p, 3, k') with k' >= k a multiple of 8
    Vector<double> prior, gauge;  // (k',): the size of c is fixed by gauge^T c = 1
    double ridge;

    long filled() const { return by_landmark.size[2]; }
};

Shapes arrange(Workspace& workspace, const PerspectiveData& data);

// The visible landmarks of one image. The first one again, with weight 0, fills up vectors.
struct Sight {
    long count, filled;
    double focal[2], centre[2], sign;
    double *w[2], *omega;  // (filled,)
    int64_t* index;        // (filled,)
};

Sight room_for_sight(Workspace& workspace, long p);
void look(const PerspectiveData& data, long image, Sight& sight);

struct Unknowns {
    double R[9], t[3];
    double* c;  // (k',)
};

struct Projection {
    double* S;          // sum_i c_i B_i (3, p)
    double* turned[3];  // R S of visible landmarks
    double* X[3];
    double* r[2];    // infinite for a landmark that is not in front of the camera
    bool in_front;   // all are
};

Projection room_for_projection(Workspace& workspace, long p);
void project(const Shapes& shapes, const Sight& sight, const Unknowns& at, Projection& seen);

// 1/2 sum_j s^2 log(1 + |r_j|^2 / s^2) + ridge/2 |c - prior|^2; infinite unless all are in front.
double evaluate(const Shapes& shapes, const Sight& sight, const Unknowns& at,
                const Projection& seen, double softness);

// Project one image: X (3, p) and r (2, p) of the landmarks, all of them visible.
void project_alone(const ProjectionData& one);

namespace {

// S (3, p) = sum_i c_i B_i
void mix(const Shapes& shapes, const double* c, double* __restrict S) {
    const long k = shapes.atoms.size[0], length = 3 * shapes.atoms.size[2];
    for (long e = 0; e < length; ++e) S[e] = 0;
    const double* atoms = shapes.atoms.data;
    long i = 0;
    for (; i + 4 <= k; i += 4) {
        const double *a = atoms + i * length, *b = a + length, *d = b + length, *f = d + length;
        const double ca = c[i], cb = c[i + 1], cd = c[i + 2], cf = c[i + 3];
        for (long e = 0; e < length; ++e) S[e] += ca * a[e] + cb * b[e] + cd * d[e] + cf * f[e];
    }
    for (; i < k; ++i) add_to(S, c[i], atoms + i * length, length);
}

}  // namespace

Shapes arrange(Workspace& workspace, const PerspectiveData& data) {
    const long k = data.atoms.size[0], p = data.atoms.size[2], filled = padded(k);
    Shapes shapes{data.atoms, workspace.tensor<double>(p, 3, filled),
                  workspace.vector<double>(filled), workspace.vector<double>(filled), data.ridge};
    const double square = dot(data.prior.data, data.prior.data, k);
    for (long i = 0; i < k; ++i) {
        shapes.prior[i] = data.prior[i];
        shapes.gauge[i] = data.prior[i] / square;
        for (int b = 0; b < 3; ++b)
            for (long j = 0; j < p; ++j) shapes.by_landmark[j][b][i] = data.atoms[i][b][j];
    }
    return shapes;
}

Sight room_for_sight(Workspace& workspace, long p) {
    Sight sight{};
    for (double*& row : sight.w) row = workspace.zeros<double>(padded(p));
    sight.omega = workspace.zeros<double>(padded(p));
    sight.index = workspace.zeros<int64_t>(padded(p));
    return sight;
}

void look(const PerspectiveData& data, long image, Sight& sight) {
    const Vector<const double> omega = data.weights[image];
    sight.count = 0;
    for (long j = 0; j < omega.size[0]; ++j)
        if (omega[j] > 0) sight.index[sight.count++] = j;
    sight.filled = padded(sight.count);
    for (long e = 0; e < sight.filled; ++e) {
        const bool real = e < sight.count;
        if (!real) sight.index[e] = sight.index[0];
        sight.omega[e] = real ? omega[sight.index[e]] : 0;
        for (int a = 0; a < 2; ++a) sight.w[a][e] = data.landmarks[image][a][sight.index[e]];
    }
    for (int a = 0; a < 2; ++a) {
        sight.focal[a] = data.focal[image][a];
        sight.centre[a] = data.centre[image][a];
    }
    sight.sign = data.sign;
}

Projection room_for_projection(Workspace& workspace, long p) {
    Projection seen{};
    seen.S = workspace.zeros<double>(3 * p);
    for (double*& row : seen.turned) row = workspace.zeros<double>(padded(p));
    for (double*& row : seen.X) row = workspace.zeros<double>(padded(p));
    for (double*& row : seen.r) row = workspace.zeros<double>(padded(p));
    return seen;
}

void project(const Shapes& shapes, const Sight& sight, const Unknowns& at, Projection& seen) {
    const long p = shapes.atoms.size[2], filled = sight.filled;
    mix(shapes, at.c, seen.S);
    for (int b = 0; b < 3; ++b)  // gathered where X will be
        for (long j = 0; j < filled; ++j) seen.X[b][j] = seen.S[b * p + sight.index[j]];
    // Named pointers: an array of them hides from the compiler that they are apart.
    double *__restrict x = seen.X[0], *__restrict y = seen.X[1], *__restrict z = seen.X[2];
    double *__restrict turned_x = seen.turned[0], *__restrict turned_y = seen.turned[1];
    double *__restrict turned_z = seen.turned[2];
    double *__restrict r_x = seen.r[0], *__restrict r_y = seen.r[1];
    const double *w_x = sight.w[0], *w_y = sight.w[1], *omega = sight.omega, *R = at.R, *t = at.t;
    double behind = 0;
    for (long j = 0; j < filled; ++j) {
        const double S_x = x[j], S_y = y[j], S_z = z[j];
        turned_x[j] = R[0] * S_x + R[1] * S_y + R[2] * S_z;
        turned_y[j] = R[3] * S_x + R[4] * S_y + R[5] * S_z;
        turned_z[j] = R[6] * S_x + R[7] * S_y + R[8] * S_z;
        x[j] = turned_x[j] + t[0];
        y[j] = turned_y[j] + t[1];
        z[j] = turned_z[j] + t[2];
        const double depth = sight.sign * z[j], inverse = 1 / depth;
        const double u = omega[j] * (sight.centre[0] + sight.focal[0] * x[j] * inverse - w_x[j]);
        const double v = omega[j] * (sight.centre[1] + sight.focal[1] * y[j] * inverse - w_y[j]);
        r_x[j] = depth > 0 ? u : INFINITE;
        r_y[j] = depth > 0 ? v : INFINITE;
        behind += depth > 0 ? 0.0 : 1.0;
    }
    seen.in_front = behind == 0;
}

double evaluate(const Shapes& shapes, const Sight& sight, const Unknowns& at,
                const Projection& seen, double softness) {
    if (!seen.in_front) return INFINITE;
    const double square_of = square(softness), inverse = 1 / square_of;
    double loss = 0, distance = 0;
    for (long j = 0; j < sight.filled; ++j)
        loss += log_of_one_plus((square(seen.r[0][j]) + square(seen.r[1][j])) * inverse);
    for (long i = 0; i < shapes.filled(); ++i) distance += square(at.c[i] - shapes.prior[i]);
    return 0.5 * (square_of * loss + shapes.ridge * distance);
}

void project_alone(const ProjectionData& one) {
    const PerspectiveData& data = one.image;
    const long k = data.atoms.size[0], p = data.atoms.size[2];
    Workspace workspace;
    const Shapes shapes = arrange(workspace, data);
    Sight sight = room_for_sight(workspace, p);
    look(data, 0, sight);
    Projection seen = room_for_projection(workspace, p);
    Unknowns at{{}, {}, workspace.zeros<double>(shapes.filled())};
    for (int e = 0; e < 9; ++e) at.R[e] = data.rotation[0].data[e];
    for (int a = 0; a < 3; ++a) at.t[a] = data.translation[0][a];
    for (long i = 0; i < k; ++i) at.c[i] = data.coefficients[0][i];
    project(shapes, sight, at, seen);
    for (long j = 0; j < p; ++j) {
        for (int a = 0; a < 3; ++a) one.X[a][j] = seen.X[a][j];
        for (int a = 0; a < 2; ++a) one.r[a][j] = seen.r[a][j];
    }
}

const Exported<project_alone> project_perspective_exported{"project_perspective", PART};

// The square that touches Cauchy's loss from above at the residuals r, and its normal equations.
//
// At X <- X + omega x (R S) + tau and c <- c + d_c it is 1/2 |J (omega, tau, d_c) + r|^2, each row of
// J and r times the root of 1 / (1 + |r_j|^2 / s^2).

constexpr int POSE = 6;      // omega, tau
constexpr int RESIDUAL = 6;  // the column of r
constexpr int FIRST = 8;     // the column of the first coefficient; the one before is empty

// Columns: pose, r, an empty one, coefficients.
struct NormalEquations {
    Matrix<double> J;  // (2 q, 8 + k')
    Matrix<double> H;  // J^T J (8 + k', 8 + k'), its upper triangle by blocks of 8
    double *root_of_weight, *inverse_depth;  // (q,)
};

NormalEquations room_for_equations(Workspace& workspace, long filled, long p);

void linearise(const Shapes& shapes, const Sight& sight, const Unknowns& at,
               const Projection& seen, double softness, NormalEquations& equations);

namespace {

constexpr int TALL = 8;  // rows of a block of H: as many sums as hide the latency of one

// What all rows need, landmarks side by side.
void weigh(const Sight& sight, const Projection& seen, double softness,
           NormalEquations& equations) {
    double* __restrict root_of_weight = equations.root_of_weight;
    double* __restrict inverse_depth = equations.inverse_depth;
    const double inverse = 1 / square(softness);
    for (long j = 0; j < sight.filled; ++j) {
        const double size = square(seen.r[0][j]) + square(seen.r[1][j]);
        root_of_weight[j] = 1 / root(1 + size * inverse);
        inverse_depth[j] = 1 / (sight.sign * seen.X[2][j]);
    }
}

// Row a of landmark j.
void fill_row(const Shapes& shapes, const Sight& sight, const Unknowns& at, const Projection& seen,
              const NormalEquations& equations, long j, int a, double* __restrict row) {
    const double root_of_weight = equations.root_of_weight[j];
    const double inverse_depth = equations.inverse_depth[j];
    const double along = root_of_weight * sight.omega[j] * sight.focal[a] * inverse_depth;
    double v[3] = {};  // the derivative in X_j
    v[a] = along;
    v[2] = -along * seen.X[a][j] * (sight.sign * inverse_depth);
    const double x = seen.turned[0][j], y = seen.turned[1][j], z = seen.turned[2][j];
    row[0] = y * v[2] - z * v[1];
    row[1] = z * v[0] - x * v[2];
    row[2] = x * v[1] - y * v[0];
    for (int b = 0; b < 3; ++b) row[3 + b] = v[b];
    row[RESIDUAL] = root_of_weight * seen.r[a][j];
    double u[3];
    for (int b = 0; b < 3; ++b) u[b] = v[0] * at.R[b] + v[1] * at.R[3 + b] + v[2] * at.R[6 + b];
    const long filled = shapes.filled();
    const double* atoms = shapes.by_landmark[sight.index[j]].data;
    for (long i = 0; i < filled; ++i)
        row[FIRST + i] = u[0] * atoms[i] + u[1] * atoms[filled + i] + u[2] * atoms[2 * filled + i];
}

// H = J^T J in blocks of 8 x WIDTH that are summed in registers; `rows` rows of J.
void sum_squares(const NormalEquations& equations, long rows) {
    const long width = equations.H.size[0];
    const double* J = equations.J.data;
    for (long i = 0; i < width; i += TALL)
        for (long j = i; j < width; j += WIDTH) {
            Doubles total[TALL] = {};
            for (long row = 0; row < rows; ++row) {
                const double* left = J + row * width + i;
                const Doubles right = load(J + row * width + j);
                for (int e = 0; e < TALL; ++e) total[e] += left[e] * right;
            }
            for (int e = 0; e < TALL; ++e) store(equations.H[i + e].data + j, total[e]);
        }
}

}  // namespace

NormalEquations room_for_equations(Workspace& workspace, long filled, long p) {
    const long width = FIRST + filled, q = padded(p);
    return {workspace.matrix<double>(2 * p, width), workspace.matrix<double>(width, width),
            workspace.zeros<double>(q), workspace.zeros<double>(q)};
}

void linearise(const Shapes& shapes, const Sight& sight, const Unknowns& at,
               const Projection& seen, double softness, NormalEquations& equations) {
    weigh(sight, seen, softness, equations);
    for (long j = 0; j < sight.count; ++j)
        for (int a = 0; a < 2; ++a)
            fill_row(shapes, sight, at, seen, equations, j, a, equations.J[2 * j + a].data);
    sum_squares(equations, 2 * sight.count);
}

// A damped step of Levenberg and Marquardt in the pose and the coefficients.
//
//     argmin 1/2 |J d + r|^2 + ridge/2 |c + d_c - prior|^2 + damping/2 sum_i (J^T J)_ii d_i^2
//
// over d_c >= -c with gauge^T d_c = 0. The pose is eliminated from the normal equations, and what is
// left is a small convex quadratic program in c.

struct StepSpace {
    StepSpace(Workspace& workspace, long filled);

    double L[POSE][POSE];  // the pose's part of the damped matrix is L L^T
    double pull[POSE];     // L^-1 of the pose's part of the right-hand side
    Matrix<double> C;      // L^-1 of the rows between pose and coefficients (6, k')
    Matrix<double> Q;      // the quadratic program in c + d_c: 1/2 c^T Q c - h^T c (k', k')
    Vector<double> h, x;   // (k',)
    ScaledProgram program;
};

// The step from `at` to `next`.
void take_step(const Shapes& shapes, const NormalEquations& equations, double damping,
               const Unknowns& at, Unknowns& next, StepSpace& space);

namespace {

// L, L^-1 of what stands beside it, and of the right-hand side -J^T r.
void eliminate_pose(const Matrix<double>& H, double damping, StepSpace& space) {
    const long filled = space.C.size[1];
    for (int e = 0; e < POSE; ++e) {
        double* __restrict row = space.C[e].data;
        for (long i = 0; i < filled; ++i) row[i] = H[e][FIRST + i];
        space.pull[e] = -H[e][RESIDUAL];
        for (int f = 0; f < e; ++f) {
            double overlap = H[f][e];
            for (int b = 0; b < f; ++b) overlap -= space.L[e][b] * space.L[f][b];
            space.L[e][f] = overlap / space.L[f][f];
            space.pull[e] -= space.L[e][f] * space.pull[f];
            add_to(row, -space.L[e][f], space.C[f].data, filled);
        }
        double square_of = H[e][e] * (1 + damping);
        for (int f = 0; f < e; ++f) square_of -= square(space.L[e][f]);
        space.L[e][e] = root(larger(square_of, TINY));
        const double inverse = 1 / space.L[e][e];
        space.pull[e] *= inverse;
        for (long i = 0; i < filled; ++i) row[i] *= inverse;
    }
}

// Q and h of the program that is left over c + d_c.
void reduce_to_coefficients(const Shapes& shapes, const Matrix<double>& H, double damping,
                            const double* c, StepSpace& space) {
    const long filled = space.C.size[1];
    const double* C[POSE];
    for (int e = 0; e < POSE; ++e) C[e] = space.C[e].data;
    for (long i = 0; i < filled; ++i) {
        double* __restrict Q = space.Q[i].data;
        const double* row = H[FIRST + i].data + FIRST;
        const double c0 = C[0][i], c1 = C[1][i], c2 = C[2][i], c3 = C[3][i], c4 = C[4][i],
                     c5 = C[5][i];
        const long from = i / 8 * 8;  // blocks below the diagonal are not in H
        for (long j = from; j < filled; ++j)
            Q[j] = row[j] - c0 * C[0][j] - c1 * C[1][j] - c2 * C[2][j] - c3 * C[3][j] -
                   c4 * C[4][j] - c5 * C[5][j];
        Q[i] += damping * row[i] + shapes.ridge;
        for (long j = 0; j < from; ++j) Q[j] = space.Q[j][i];
    }
    for (long i = 0; i < filled; ++i) {
        double h = shapes.ridge * (shapes.prior[i] - c[i]) - H[RESIDUAL][FIRST + i];
        for (int e = 0; e < POSE; ++e) h -= C[e][i] * space.pull[e];
        space.h[i] = h + dot(space.Q[i].data, c, filled);
    }
}

// exp([omega]_x) R
void turn(const double* omega, const double* R, double* turned) {
    const double angle = root(square(omega[0]) + square(omega[1]) + square(omega[2]));
    const double sine = angle > 1e-8 ? sin(angle) / angle : 1;
    const double rest = angle > 1e-4 ? (1 - cos(angle)) / square(angle) : 0.5;
    const double cosine = 1 - rest * square(angle);
    for (int b = 0; b < 3; ++b) {
        const double x = R[b], y = R[3 + b], z = R[6 + b];
        const double along = rest * (omega[0] * x + omega[1] * y + omega[2] * z);
        turned[b] = cosine * x + sine * (omega[1] * z - omega[2] * y) + along * omega[0];
        turned[3 + b] = cosine * y + sine * (omega[2] * x - omega[0] * z) + along * omega[1];
        turned[6 + b] = cosine * z + sine * (omega[0] * y - omega[1] * x) + along * omega[2];
    }
}

}  // namespace

StepSpace::StepSpace(Workspace& workspace, long filled)
    : L{},
      pull{},
      C(workspace.matrix<double>(POSE, filled)),
      Q(workspace.matrix<double>(filled, filled)),
      h(workspace.vector<double>(filled)),
      x(workspace.vector<double>(filled)),
      program(workspace, filled) {}

void take_step(const Shapes& shapes, const NormalEquations& equations, double damping,
               const Unknowns& at, Unknowns& next, StepSpace& space) {
    const long filled = shapes.filled();
    eliminate_pose(equations.H, damping, space);
    reduce_to_coefficients(shapes, equations.H, damping, at.c, space);
    for (long i = 0; i < filled; ++i) next.c[i] = at.c[i];
    scaled_coefficients(space.program, {space.Q.data, {filled, filled}}, {space.h.data, {filled}},
                        {shapes.gauge.data, {filled}}, {next.c, {filled}});
    for (long i = 0; i < filled; ++i) space.x[i] = next.c[i] - at.c[i];
    double pose[POSE];
    for (int e = POSE - 1; e >= 0; --e) {
        double value = space.pull[e] - dot(space.C[e].data, space.x.data, filled);
        for (int f = e + 1; f < POSE; ++f) value -= space.L[f][e] * pose[f];
        pose[e] = value / space.L[e][e];
    }
    turn(pose, at.R, next.R);
    for (int a = 0; a < 3; ++a) next.t[a] = at.t[a] + pose[3 + a];
}

// Refinement of pose and coefficients under a full perspective projection, image after image.

// Levenberg-Marquardt steps until the objective settles. The softness halves from 1 to its last
// value, so that many landmarks pull while the pose is still coarse. DEGENERATE where a landmark
// begins behind the camera: no step is taken from there.
void refine_perspective(const PerspectiveData& data, Range range);

namespace {

constexpr double FIRST_DAMPING = 1e-3, LEAST_DAMPING = 1e-9, MOST_DAMPING = 1e8;
constexpr double EASE = 0.2, HARDEN = 5;  // of the damping after a step that was kept, or was not
constexpr double SETTLED = 1e-10;  // relative fall of the objective that ends the last softness,
constexpr double FLEETING = 1e-2;  // and the softer ones before it

// Where the refinement of an image is.
struct Position {
    Unknowns at;
    Projection seen;
};

struct Refinement {
    Refinement(Workspace& workspace, const PerspectiveData& data)
        : shapes(arrange(workspace, data)),
          sight(room_for_sight(workspace, data.atoms.size[2])),
          equations(room_for_equations(workspace, shapes.filled(), data.atoms.size[2])),
          space(workspace, shapes.filled()) {
        for (Position& position : positions)
            position = {{{}, {}, workspace.zeros<double>(shapes.filled())},
                        room_for_projection(workspace, data.atoms.size[2])};
    }

    Position& here() { return positions[current]; }
    Position& there() { return positions[1 - current]; }
    double evaluate_at(const Position& position, double soft) const {
        return evaluate(shapes, sight, position.at, position.seen, soft);
    }

    Shapes shapes;
    Sight sight;
    NormalEquations equations;
    StepSpace space;
    Position positions[2];
    int current = 0;
};

struct Refined {
    double objective;
    long rounds;
    int64_t status;
};

// Take the first damped step that lowers the objective F; by what share it fell, 0 for none.
double improve(Refinement& refinement, double soft, double& damping, double& F) {
    const Position& here = refinement.here();
    Position& there = refinement.there();
    linearise(refinement.shapes, refinement.sight, here.at, here.seen, soft, refinement.equations);
    for (; damping <= MOST_DAMPING; damping *= HARDEN) {
        take_step(refinement.shapes, refinement.equations, damping, here.at, there.at,
                  refinement.space);
        project(refinement.shapes, refinement.sight, there.at, there.seen);
        const double trial = refinement.evaluate_at(there, soft);
        if (!(trial < F)) continue;
        const double fall = (F - trial) / F;
        F = trial;
        refinement.current = 1 - refinement.current;
        damping = larger(damping * EASE, LEAST_DAMPING);
        return fall;
    }
    return 0;
}

// Refine from where `here` is.
Refined refine(Refinement& refinement, double softness, long most_rounds) {
    double soft = larger(1, softness), damping = FIRST_DAMPING;
    project(refinement.shapes, refinement.sight, refinement.here().at, refinement.here().seen);
    double F = refinement.evaluate_at(refinement.here(), soft);
    if (!refinement.here().seen.in_front) return {NOT_A_NUMBER, 0, Status::DEGENERATE};
    if (!is_finite(F)) return {NOT_A_NUMBER, 0, Status::NUMERICAL_FAILURE};
    for (long round = 1; round <= most_rounds; ++round) {
        const double fall = improve(refinement, soft, damping, F);
        if (soft <= softness && fall <= SETTLED) return {F, round, Status::CONVERGED};
        if (soft > softness && fall <= FLEETING) {
            soft = larger(0.5 * soft, softness);
            damping = FIRST_DAMPING;
            F = refinement.evaluate_at(refinement.here(), soft);
        }
    }
    return {refinement.evaluate_at(refinement.here(), softness), most_rounds, Status::ITERATION_LIMIT};
}

void start(const PerspectiveData& data, long image, Unknowns& at) {
    for (int e = 0; e < 9; ++e) at.R[e] = data.rotation[image].data[e];
    for (int a = 0; a < 3; ++a) at.t[a] = data.translation[image][a];
    for (long i = 0; i < data.atoms.size[0]; ++i) at.c[i] = data.coefficients[image][i];
}

void finish(const Unknowns& at, long image, const PerspectiveData& data) {
    for (int e = 0; e < 9; ++e) data.rotation[image].data[e] = at.R[e];
    for (int a = 0; a < 3; ++a) data.translation[image][a] = at.t[a];
    for (long i = 0; i < data.atoms.size[0]; ++i) data.coefficients[image][i] = at.c[i];
}

}  // namespace

void refine_perspective(const PerspectiveData& data, Range range) {
    Workspace workspace;
    Refinement refinement(workspace, data);
    for (long image = range.first; image < range.last; ++image) {
        look(data, image, refinement.sight);
        start(data, image, refinement.here().at);
        const Refined refined = refine(refinement, data.softness, data.most_rounds);
        finish(refinement.here().at, image, data);
        data.objective[image] = refined.objective;
        data.rounds[image] = refined.rounds;
        data.status[image] = refined.status;
    }
}

const Exported<refine_perspective> refine_perspective_exported{"refine_perspective"};

}  // namespace shapefit
