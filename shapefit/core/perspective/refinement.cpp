// Refinement of camera and shape under the full perspective projection, image after
// image.
//
//     X_j = R sum_i c_i B_ij + t,    r_j = omega_j (centre + focal X_xy / (sign X_z) -
//     w_j) min over R, t, c >= 0 of  1/2 sum_j s^2 log(1 + |r_j|^2 / s^2) + ridge/2 |c
//     - prior|^2
//
// by the method of Levenberg and Marquardt: at X <- X + omega x (R S) + tau and c <- c
// + d_c a step is
//
//     argmin 1/2 |J d + r|^2 + ridge/2 |c + d_c - prior|^2 + damping/2 sum_i (J^T J)_ii
//     d_i^2
//
// over d_c >= -c with gauge^T d_c = 0, where 1/2 |J d + r|^2 is the square that touches
// Cauchy's loss from above at r: each row of J and r has the root of 1 / (1 + |r_j|^2 /
// s^2) as a factor. The pose is eliminated from the normal equations, and what is left
// is a small convex quadratic program in c.
#include "../base/active_set.hpp"
#include "../base/registry.hpp"
#include "../pose/rotation.hpp"

namespace shapefit {

struct PerspectiveData {
    Arguments& from;
    Tensor<const double> landmarks = from("landmarks", "n 2 p");  // w
    Matrix<const double> weights = from("weights", "n p");        // Omega, 0 = hidden
    Tensor<const double> atoms = from("atoms", "k 3 p");          // B
    Vector<const double> prior = from("prior", "k");
    Matrix<const double> focal = from("focal", "n 2");
    Matrix<const double> centre = from("centre", "n 2");
    double sign =
        from("sign");  // of the depth: 1 where z points away from the camera, else -1
    double ridge = from("ridge");
    double softness = from("softness");  // s at the end
    Index most_rounds = from("max_rounds");
    Tensor<double> rotation = from("rotation", "n 3 3");  // R, the start, overwritten
    Matrix<double> translation = from("translation", "n 3");    // t, likewise
    Matrix<double> coefficients = from("coefficients", "n k");  // c, likewise
    Vector<double> objective = from("objective", "n");
    Vector<int64_t> rounds = from("rounds", "n");
    Vector<int64_t> status = from("status", "n");
};

namespace {

constexpr double FIRST_DAMPING = 1e-3, LEAST_DAMPING = 1e-9, MOST_DAMPING = 1e8;
constexpr double EASE = 0.2,
                 HARDEN = 5;  // of the damping after a step that was kept, or was not
constexpr double SETTLED =
    1e-10;  // relative fall of the objective that ends the last softness,
constexpr double FLEETING = 1e-2;  // and the softer ones before it
constexpr double DEPENDENT = 1e-14,
                 SLACK = 1e-10;  // of the quadratic program, see below

// Columns of the normal equations: pose (omega, tau), r, an empty one, coefficients.
constexpr int POSE = 6, RESIDUAL = 6, FIRST = 8;

// The atoms of all images; atoms of zeros fill up vectors, and their coefficients stay
// 0.
struct Shapes {
    Shapes(Workspace& workspace, const PerspectiveData& data)
        : k(data.atoms.size[0]),
          p(data.atoms.size[2]),
          filled(padded(k)),
          ridge(data.ridge),
          rows(workspace.matrix<double>(filled, padded(3 * p))),
          by_landmark(workspace.tensor<double>(p, 3, filled)),
          prior(workspace.vector<double>(filled)),
          gauge(workspace.vector<double>(filled)) {
        const double square = dot(data.prior.data, data.prior.data, k);
        for (Index i = 0; i < k; ++i) {
            prior[i] = data.prior[i];
            gauge[i] = data.prior[i] / square;
            for (int b = 0; b < 3; ++b)
                for (Index j = 0; j < p; ++j)
                    by_landmark[j][b][i] = rows[i][b * p + j] = data.atoms[i][b][j];
        }
    }

    const Index k, p, filled;  // filled: k', a multiple of 8
    const double ridge;
    Matrix<double> rows;          // (k', 3 p)
    Tensor<double> by_landmark;   // (p, 3, k')
    Vector<double> prior, gauge;  // (k',): the size of c is fixed by gauge^T c = 1
};

// The visible landmarks of one image. The first one again, with weight 0, fills up
// vectors.
struct Observations {
    Observations(Workspace& workspace, Index p)
        : w{workspace.zeros<double>(padded(p)), workspace.zeros<double>(padded(p))},
          omega(workspace.zeros<double>(padded(p))),
          index(workspace.zeros<int64_t>(padded(p))) {}

    void take(const PerspectiveData& data, Index image) {
        const Vector<const double> weight = data.weights[image];
        count = 0;
        for (Index j = 0; j < weight.size[0]; ++j)
            if (weight[j] > 0) index[count++] = j;
        filled = padded(count);
        for (Index e = 0; e < filled; ++e) {
            if (e >= count) index[e] = index[0];
            omega[e] = e < count ? weight[index[e]] : 0;
            for (int a = 0; a < 2; ++a) w[a][e] = data.landmarks[image][a][index[e]];
        }
        for (int a = 0; a < 2; ++a) {
            focal[a] = data.focal[image][a];
            centre[a] = data.centre[image][a];
        }
        sign = data.sign;
    }

    Index count = 0, filled = 0;
    double focal[2] = {}, centre[2] = {}, sign = 1;
    double *w[2], *omega;  // (filled,)
    int64_t* index;        // (filled,)
};

struct Unknowns {
    Rotation R;
    double t[3];
    double* c;  // (k',)
};

// Where the refinement of an image is: the unknowns, and what the camera sees there.
struct Position {
    Position(Workspace& workspace, const Shapes& shapes)
        : at{{}, {}, workspace.zeros<double>(shapes.filled)},
          S(workspace.zeros<double>(padded(3 * shapes.p))) {
        for (double*& row : turned) row = workspace.zeros<double>(padded(shapes.p));
        for (double*& row : X) row = workspace.zeros<double>(padded(shapes.p));
        for (double*& row : r) row = workspace.zeros<double>(padded(shapes.p));
    }

    Unknowns at;
    double* S;                 // sum_i c_i B_i (3, p)
    double *turned[3], *X[3];  // R S and X of visible landmarks
    double* r[2];  // infinite for a landmark that is not in front of the camera
    bool in_front = false;  // all are
};

void project(const Shapes& shapes, const Observations& observations, Position& here) {
    const Index p = shapes.p, filled = observations.filled, length = padded(3 * p);
    mix_rows(here.at.c, shapes.k, shapes.rows.data, length, length, here.S);
    for (int b = 0; b < 3; ++b)  // gathered where X will be
        for (Index j = 0; j < filled; ++j)
            here.X[b][j] = here.S[b * p + observations.index[j]];
    // Named pointers: an array of them hides from the compiler that they are apart.
    double* __restrict x = here.X[0];
    double* __restrict y = here.X[1];
    double* __restrict z = here.X[2];
    double* __restrict turned_x = here.turned[0], * __restrict turned_y =
                                                      here.turned[1];
    double* __restrict turned_z = here.turned[2];
    double* __restrict r_x = here.r[0], * __restrict r_y = here.r[1];
    const double *w_x = observations.w[0], *w_y = observations.w[1],
                 *omega = observations.omega;
    const double *R = here.at.R, *t = here.at.t;
    double behind = 0;
    for (Index j = 0; j < filled; ++j) {
        const double S_x = x[j], S_y = y[j], S_z = z[j];
        turned_x[j] = R[0] * S_x + R[1] * S_y + R[2] * S_z;
        turned_y[j] = R[3] * S_x + R[4] * S_y + R[5] * S_z;
        turned_z[j] = R[6] * S_x + R[7] * S_y + R[8] * S_z;
        x[j] = turned_x[j] + t[0];
        y[j] = turned_y[j] + t[1];
        z[j] = turned_z[j] + t[2];
        const double depth = observations.sign * z[j], inverse = 1 / depth;
        const double u = omega[j] * (observations.centre[0] +
                                     observations.focal[0] * x[j] * inverse - w_x[j]);
        const double v = omega[j] * (observations.centre[1] +
                                     observations.focal[1] * y[j] * inverse - w_y[j]);
        r_x[j] = depth > 0 ? u : INFINITE;
        r_y[j] = depth > 0 ? v : INFINITE;
        behind += depth > 0 ? 0.0 : 1.0;
    }
    here.in_front = behind == 0;
}

// The objective; infinite unless all landmarks are in front.
double evaluate(const Shapes& shapes, const Observations& observations,
                const Position& here, double softness) {
    if (!here.in_front) return INFINITE;
    const double square_of = square(softness), inverse = 1 / square_of;
    double loss = 0, distance = 0;
    for (Index j = 0; j < observations.filled; ++j)
        loss +=
            log_of_one_plus((square(here.r[0][j]) + square(here.r[1][j])) * inverse);
    for (Index i = 0; i < shapes.filled; ++i)
        distance += square(here.at.c[i] - shapes.prior[i]);
    return 0.5 * (square_of * loss + shapes.ridge * distance);
}

class NormalEquations {
  public:
    NormalEquations(Workspace& workspace, const Shapes& shapes)
        : shapes_(shapes),
          width_(FIRST + shapes.filled),
          J_(workspace.matrix<double>(2 * shapes.p, width_)),
          H_(workspace.matrix<double>(width_, width_)),
          root_of_weight_(workspace.zeros<double>(padded(shapes.p))),
          inverse_depth_(workspace.zeros<double>(padded(shapes.p))),
          C_(workspace.matrix<double>(POSE, shapes.filled)),
          Q_(workspace.matrix<double>(shapes.filled, shapes.filled)),
          h_(workspace.zeros<double>(shapes.filled)),
          score_(workspace.zeros<double>(shapes.filled)),
          ones_(workspace.zeros<double>(shapes.filled)),
          change_(workspace.zeros<double>(shapes.filled)),
          set_(workspace, shapes.filled) {
        for (Index i = 0; i < shapes.filled; ++i) ones_[i] = 1;
    }

    // H = J^T J at a position, its upper triangle by blocks of 8.
    void linearise(const Observations& observations, const Position& here,
                   double softness) {
        const double inverse = 1 / square(softness);
        double* __restrict root_of_weight = root_of_weight_;
        double* __restrict inverse_depth = inverse_depth_;
        for (Index j = 0; j < observations.filled; ++j) {
            const double size = square(here.r[0][j]) + square(here.r[1][j]);
            root_of_weight[j] = 1 / root(1 + size * inverse);
            inverse_depth[j] = 1 / (observations.sign * here.X[2][j]);
        }
        for (Index j = 0; j < observations.count; ++j)
            for (int a = 0; a < 2; ++a)
                fill_row(observations, here, j, a, J_[2 * j + a].data);
        sum_squares(2 * observations.count);
    }

    void step(double damping, const Unknowns& at, Unknowns& next) {
        const Index filled = shapes_.filled;
        eliminate_pose(damping);
        reduce_to_coefficients(damping, at.c);
        for (Index i = 0; i < filled; ++i) next.c[i] = at.c[i];
        minimise_scaled(next.c);
        for (Index i = 0; i < filled; ++i) change_[i] = next.c[i] - at.c[i];
        double pose[POSE];
        for (int e = POSE - 1; e >= 0; --e) {
            double value = linear_term_[e] - dot(C_[e].data, change_, filled);
            for (int f = e + 1; f < POSE; ++f) value -= L_[f][e] * pose[f];
            pose[e] = value / L_[e][e];
        }
        next.R = at.R.turned(pose);
        for (int a = 0; a < 3; ++a) next.t[a] = at.t[a] + pose[3 + a];
    }

  private:
    // Row a of landmark j.
    void fill_row(const Observations& observations, const Position& here, Index j,
                  int a, double* __restrict row) const {
        const double root_of_weight = root_of_weight_[j],
                     inverse_depth = inverse_depth_[j];
        const double along = root_of_weight * observations.omega[j] *
                             observations.focal[a] * inverse_depth;
        double v[3] = {}, u[3];  // the derivative in X_j, and in the frame of the atoms
        v[a] = along;
        v[2] = -along * here.X[a][j] * (observations.sign * inverse_depth);
        const double turned[3] = {here.turned[0][j], here.turned[1][j],
                                  here.turned[2][j]};
        cross(turned, v, row);
        for (int b = 0; b < 3; ++b) row[3 + b] = v[b];
        row[RESIDUAL] = root_of_weight * here.r[a][j];
        const double* R = here.at.R;
        for (int b = 0; b < 3; ++b)
            u[b] = v[0] * R[b] + v[1] * R[3 + b] + v[2] * R[6 + b];
        const Index filled = shapes_.filled;
        const double* atoms = shapes_.by_landmark[observations.index[j]].data;
        for (Index i = 0; i < filled; ++i)
            row[FIRST + i] = u[0] * atoms[i] + u[1] * atoms[filled + i] +
                             u[2] * atoms[2 * filled + i];
    }

    // H in blocks of 8 x WIDTH that are summed in registers: as many sums as hide the
    // latency of one.
    void sum_squares(Index rows) {
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

    // With L L^T the pose's part of the damped matrix: C = L^-1 H_pose,c and pull =
    // -L^-1 J_pose^T r.
    void eliminate_pose(double damping) {
        const Index filled = shapes_.filled;
        for (int e = 0; e < POSE; ++e) {
            double* __restrict row = C_[e].data;
            for (Index i = 0; i < filled; ++i) row[i] = H_[e][FIRST + i];
            linear_term_[e] = -H_[e][RESIDUAL];
            double pivot = H_[e][e] * (1 + damping);
            for (int f = 0; f < e; ++f) {
                double overlap = H_[f][e];
                for (int b = 0; b < f; ++b) overlap -= L_[e][b] * L_[f][b];
                L_[e][f] = overlap / L_[f][f];
                linear_term_[e] -= L_[e][f] * linear_term_[f];
                pivot -= square(L_[e][f]);
                add_to(row, -L_[e][f], C_[f].data, filled);
            }
            L_[e][e] = root(larger(pivot, TINY));
            const double inverse = 1 / L_[e][e];
            linear_term_[e] *= inverse;
            for (Index i = 0; i < filled; ++i) row[i] *= inverse;
        }
    }

    // Q and h of the quadratic program that is left over c + d_c.
    void reduce_to_coefficients(double damping, const double* c) {
        const Index filled = shapes_.filled;
        const double* C[POSE];
        for (int e = 0; e < POSE; ++e) C[e] = C_[e].data;
        for (Index i = 0; i < filled; ++i) {
            double* __restrict Q = Q_[i].data;
            const double* row = H_[FIRST + i].data + FIRST;
            const double c0 = C[0][i], c1 = C[1][i], c2 = C[2][i], c3 = C[3][i],
                         c4 = C[4][i], c5 = C[5][i];
            const Index from = i / 8 * 8;  // blocks below the diagonal are not in H
            for (Index j = from; j < filled; ++j)
                Q[j] = row[j] - c0 * C[0][j] - c1 * C[1][j] - c2 * C[2][j] -
                       c3 * C[3][j] - c4 * C[4][j] - c5 * C[5][j];
            Q[i] += damping * row[i] + shapes_.ridge;
            for (Index j = 0; j < from; ++j) Q[j] = Q_[j][i];
        }
        for (Index i = 0; i < filled; ++i) {
            double h =
                shapes_.ridge * (shapes_.prior[i] - c[i]) - H_[RESIDUAL][FIRST + i];
            for (int e = 0; e < POSE; ++e) h -= C[e][i] * linear_term_[e];
            h_[i] = h + dot(Q_[i].data, c, filled);
        }
    }

    // Overwrite x, feasible, with argmin 1/2 x^T Q x - h^T x over x >= 0, gauge^T x
    // = 1.
    void minimise_scaled(double* x) {
        const Index filled = shapes_.filled;
        double largest = 0;
        set_.clear();
        for (Index i = 0; i < filled; ++i) {
            largest = larger(magnitude(h_[i]), largest);
            if (x[i] > 0) set_.use(i, x[i], 1);
        }
        DenseTerms<true> terms{
            Q_.data, h_, shapes_.gauge.data, ones_, SLACK * largest, score_, filled};
        minimise(terms, set_, DEPENDENT, 10 * filled + 100);
        set_.write({x, {filled}});
    }

    const Shapes& shapes_;
    const Index width_;
    Matrix<double> J_, H_;                     // (2 p, 8 + k'), (8 + k', 8 + k')
    double *root_of_weight_, *inverse_depth_;  // (p,)
    double L_[POSE][POSE], linear_term_[POSE];
    Matrix<double> C_, Q_;                  // (6, k'), (k', k')
    double *h_, *score_, *ones_, *change_;  // (k',)
    ActiveSet set_;
};

struct Refined {
    double objective;
    Index rounds;
    int64_t status;
};

class Refinement {
  public:
    Refinement(Workspace& workspace, const PerspectiveData& data)
        : data_(data),
          shapes_(workspace, data),
          observations_(workspace, shapes_.p),
          equations_(workspace, shapes_),
          positions_{{workspace, shapes_}, {workspace, shapes_}} {}

    // The softness halves from 1 to its last value, so that many landmarks pull while
    // the pose is still coarse. DEGENERATE where a landmark begins behind the camera:
    // no step is taken from there.
    void refine(Index image) {
        observations_.take(data_, image);
        Unknowns& start = here().at;
        start.R = Rotation::from(data_.rotation[image].data);
        for (int a = 0; a < 3; ++a) start.t[a] = data_.translation[image][a];
        for (Index i = 0; i < shapes_.k; ++i) start.c[i] = data_.coefficients[image][i];
        const Refined refined = go_on();
        const Unknowns& at = here().at;
        at.R.write(data_.rotation[image].data);
        for (int a = 0; a < 3; ++a) data_.translation[image][a] = at.t[a];
        for (Index i = 0; i < shapes_.k; ++i) data_.coefficients[image][i] = at.c[i];
        data_.objective[image] = refined.objective;
        data_.rounds[image] = refined.rounds;
        data_.status[image] = refined.status;
    }

  private:
    Position& here() { return positions_[current_]; }
    double value(double soft) { return evaluate(shapes_, observations_, here(), soft); }

    Refined go_on() {
        double soft = larger(1, data_.softness), damping = FIRST_DAMPING;
        project(shapes_, observations_, here());
        double F = value(soft);
        if (!here().in_front) return {NOT_A_NUMBER, 0, Status::DEGENERATE};
        if (!is_finite(F)) return {NOT_A_NUMBER, 0, Status::NUMERICAL_FAILURE};
        for (Index round = 1; round <= data_.most_rounds; ++round) {
            const double fall = improve(soft, damping, F);
            if (soft <= data_.softness && fall <= SETTLED)
                return {F, round, Status::CONVERGED};
            if (soft > data_.softness && fall <= FLEETING) {
                soft = larger(0.5 * soft, data_.softness);
                damping = FIRST_DAMPING;
                F = value(soft);
            }
        }
        return {value(data_.softness), data_.most_rounds, Status::ITERATION_LIMIT};
    }

    // Take the first damped step that lowers the objective F; by what share it fell, 0
    // for none.
    double improve(double soft, double& damping, double& F) {
        Position& there = positions_[1 - current_];
        equations_.linearise(observations_, here(), soft);
        for (; damping <= MOST_DAMPING; damping *= HARDEN) {
            check_interrupt();
            equations_.step(damping, here().at, there.at);
            project(shapes_, observations_, there);
            const double trial = evaluate(shapes_, observations_, there, soft);
            if (!(trial < F)) continue;
            const double fall = (F - trial) / F;
            F = trial;
            current_ = 1 - current_;
            damping = larger(damping * EASE, LEAST_DAMPING);
            return fall;
        }
        return 0;
    }

    const PerspectiveData& data_;
    Shapes shapes_;
    Observations observations_;
    NormalEquations equations_;
    Position positions_[2];
    int current_ = 0;
};

}  // namespace

void refine_perspective(const PerspectiveData& data, Range range) {
    Workspace workspace;
    Refinement refinement(workspace, data);
    for (Index image = range.first; image < range.last; ++image)
        refinement.refine(image);
}

const Exported<refine_perspective> refine_perspective_exported{"refine_perspective"};

}  // namespace shapefit
