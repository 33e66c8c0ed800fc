// The convex programs of data.hpp for a block of images, each solved from its
// neighbour's solution where that fits its landmarks, and their certificates
// (P - D) / P.
#include <string.h>

#include "../base/registry.hpp"
#include "data.hpp"
#include "newton.hpp"

namespace shapefit {

namespace {

// The solver aims a little below the tolerance, so that the certificate in the units of
// the data, which rounds differently, agrees with it. This saves a second round, and
// decides nothing else.
constexpr double TOLERANCE_SHARE = 0.99;
// Where it does not, as with weights over six orders at a gap of 1e-10, the solver goes
// on once, to this share of the tolerance.
constexpr double SECOND_TOLERANCE_SHARE = 0.1;
// A neighbour's transforms are a start where they leave less than this share of
// ||w||^2.
constexpr double MAX_UNEXPLAINED_SHARE = 0.1;
// The start goes on from the last two solutions by this share of their difference.
constexpr double EXTRAPOLATION = 0.5;

// Nuclear norms are roots of products of four entries of Y B^T, which are of the size
// of lambda where they count. Below this lambda they underflow, and what is not
// feasible would pass.
constexpr double MIN_LAMBDA = 1e-72;

// (P - D) / P, 0 where both are 0, and nan where D is no bound.
double relative_gap(double primal, double dual, double lam) {
    if (lam < MIN_LAMBDA) return NOT_A_NUMBER;
    return primal == 0 ? 0 : (primal - dual) / primal;
}

// The certificate from scratch: original data in, objective and gap out.
struct Certifier {
    const ConvexProgram& program;
    Planes planes;            // B (3, p, padded)
    Matrix<double> centred;   // W less its mean
    Matrix<double> left;      // what M leaves of it
    Matrix<double> weighted;  // Omega o Y
    double* N;                // (6, padded)

    Certifier(const ConvexProgram& data, Workspace& workspace)
        : program(data),
          planes(make_planes(data.atoms, workspace)),
          centred(workspace.matrix<double>(2, data.atoms.size[2])),
          left(workspace.matrix<double>(2, data.atoms.size[2])),
          weighted(workspace.matrix<double>(2, data.atoms.size[2])),
          N(workspace.zeros<double>(6 * planes.padded_atoms)) {}

    // P = f(Omega o (W - sum M_i B_i - T 1^T)) + lambda sum ||M_i||_2, its gap to
    // D = <Y, Omega o W> - delta/2 ||Y||^2, and the residual, for one image.
    //
    // On entry E holds the sparse errors from which the translation follows: the mean
    // of what M and E leave, weighted by omega^2 where the loss has a quadratic. On
    // return it holds those that minimise the objective, T is written, and Y has been
    // made orthogonal to omega and scaled until it is dual feasible, so P - D bounds
    // the distance to the optimum whatever the solver did.
    void certify(Index image, const ImageTransforms& M, const ConvexPoint& point,
                 const ConvexProof& proof);
};

// The objective, and the squared norms of residual and landmarks, as far as summed.
struct Sums {
    double primal = 0, residual = 0, scale = 0;
};

// Set mean (2,) to the mean of W with the weights omega^2, and `centred` and `left` to
// W less it, 0 where hidden; returns sum_j omega_j^2.
double centre(Matrix<const double> W, Vector<const double> omega, Certifier& work,
              double* mean) {
    const Index p = omega.size[0];
    double total = 0;
    Index first = -1;
    for (Index j = 0; j < p; ++j) {
        total += square(omega[j]);
        if (omega[j] > 0 && first < 0) first = j;
    }
    for (int a = 0; a < 2; ++a) {
        // taken off first: landmarks on one point give exact 0; 0 where nothing is seen
        const double anchor = first < 0 ? 0 : W[a][first];
        mean[a] = 0;
        for (Index j = 0; j < p; ++j)
            if (omega[j] > 0) mean[a] += square(omega[j]) * (W[a][j] - anchor) / total;
        for (Index j = 0; j < p; ++j) {
            const double value = omega[j] > 0 ? W[a][j] - anchor - mean[a] : 0;
            work.centred[a][j] = value;
            work.left[a][j] = value;
        }
        mean[a] += anchor;
    }
    return total;
}

// left -= sum M_i B_i; returns sum ||M_i||_2.
double subtract_shapes(const ImageTransforms& M, Tensor<const double> B,
                       Matrix<double> left) {
    const Index p = B.size[2];
    double norms = 0;
    for (Index e = 0; e < M.count; ++e) {
        const double* m = M.blocks + 6 * e;
        const double q[6] = {m[0], m[1], m[2], m[3], m[4], m[5]};
        subtract_shape(q, B[M.atom[e]].data, p, left.data, p);
        norms += spectral_norm(invariants(q));
    }
    return norms;
}

// The translation of one axis less the mean of W: the mean of what M and, where given,
// E leave of it.
double find_shift(Vector<const double> omega, const double* left, const double* E,
                  bool quadratic) {
    double shift = 0, total = 0;
    for (Index j = 0; j < omega.size[0]; ++j) {
        if (!(omega[j] > 0)) continue;
        const double weight = quadratic ? square(omega[j]) : 1;
        shift += weight * (E ? left[j] - E[j] / omega[j] : left[j]);
        total += weight;
    }
    return shift / total;
}

// Add the loss and the residual of one axis to the sums, write its errors E, and make
// its Y orthogonal to omega, whose square is `total`.
void add_axis(const ConvexProgram& program, Vector<const double> omega, double total,
              double shift, const double* centred, const double* left, double* E,
              double* Y, Sums& sums) {
    const bool robust = program.bound < INFINITE, quadratic = program.delta > 0;
    const double bound = program.bound;
    double along = 0;
    for (Index j = 0; j < omega.size[0]; ++j) {
        const double r = omega[j] * (left[j] - shift), size = magnitude(r);
        sums.residual += r * r;
        sums.scale += square(omega[j] * centred[j]);
        const double excess = larger(size - bound, 0);
        if (robust) E[j] = quadratic ? sign_of(r) * excess : r;
        if (quadratic)
            sums.primal +=
                robust && excess > 0 ? bound * (size - 0.5 * bound) : 0.5 * r * r;
        else if (robust) sums.primal += bound * size;
        along += Y[j] * omega[j] / total;
    }
    for (Index j = 0; j < omega.size[0]; ++j)
        Y[j] = omega[j] > 0 ? Y[j] - along * omega[j] : 0;
}

// Scale Y (2, p) until it is dual feasible; returns the bound D.
double find_bound(const ConvexProgram& program, Vector<const double> omega, double lam,
                  Certifier& work, Matrix<double> Y) {
    const Index p = omega.size[0];
    double yy = 0, yw = 0, entry = 0;
    for (int a = 0; a < 2; ++a)
        for (Index j = 0; j < p; ++j) {
            work.weighted[a][j] = Y[a][j] * omega[j];
            yy += square(Y[a][j]);
            yw += work.weighted[a][j] * work.centred[a][j];
            entry = larger(entry, magnitude(Y[a][j]));
        }
    correlate(work.planes, work.weighted[0].data, work.weighted[1].data, work.N);
    const double largest = largest_nuclear_norm(work.N, work.planes.padded_atoms);
    const DualBound bound(lam, program.delta, largest, entry / program.bound, yy, yw);
    for (Index e = 0; e < 2 * p; ++e) Y.data[e] *= bound.scale;
    return bound.value;
}

// Write the objective of an image at its point, a dual bound below it, and their gap.
void Certifier::certify(Index image, const ImageTransforms& M, const ConvexPoint& point,
                        const ConvexProof& proof) {
    const Vector<const double> omega = program.weights[image];
    double mean[2];
    const double total = centre(program.landmarks[image], omega, *this, mean);
    const double norms = subtract_shapes(M, program.atoms, left);
    Sums sums;
    sums.primal = program.lam[image] * norms;
    for (int a = 0; a < 2; ++a) {
        double *E = point.errors[image][a].data, *Y = point.dual[image][a].data;
        const bool quadratic = program.delta > 0,
                   squared = quadratic && !(program.bound < INFINITE);
        const double shift =
            find_shift(omega, left[a].data, squared ? nullptr : E, quadratic);
        point.translation[image][a] = mean[a] + shift;
        add_axis(program, omega, total, shift, centred[a].data, left[a].data, E, Y,
                 sums);
    }
    const double dual =
        find_bound(program, omega, program.lam[image], *this, point.dual[image]);
    proof.objective[image] = sums.primal;
    proof.relative_gap[image] = relative_gap(sums.primal, dual, program.lam[image]);
    proof.residual[image] = sums.scale > 0 ? root(sums.residual / sums.scale) : 0;
}

// Sizes of the reduced units: ||w||, max ||B_i|| and the unit of the dual.
struct Units {
    double landmarks = 1, atoms = 1, dual = 1;
    // The unit of M.
    double transforms() const { return landmarks / atoms; }
};

// The transforms of an image that are not 0.
struct ActiveList {
    int64_t* atom;
    double* blocks;
    Index count = 0;
    operator ImageTransforms() const { return {atom, blocks, count}; }
};

// A solution in the units of the data, and whether there is one.
struct Memory {
    double *M, *y;
    bool known = false;
};

// Solves the images of a block one after another, and certifies each.
class BlockSolver {
  public:
    explicit BlockSolver(const ConvexTask& task)
        : task_(task),
          program_(task.program),
          k_(program_.atoms.size[0]),
          p_(program_.atoms.size[2]),
          certifier_(program_, workspace_),
          reduction_(workspace_, p_),
          padded_(certifier_.planes.padded_atoms),
          atoms_(workspace_, certifier_.planes, padded_),
          errors_(workspace_, p_),
          work_(workspace_, padded_, p_ > 1 ? p_ - 1 : 1, is_robust() ? 2 * p_ : 0) {
        const auto numbers = [&](Index count) {
            return workspace_.zeros<double>(count);
        };
        active_ = {workspace_.zeros<int64_t>(padded_ + 1), numbers(6 * padded_)};
        last_weights_ = workspace_.vector<double>(p_);
        rho_ = workspace_.vector<double>(p_);
        bounds_ = numbers(p_), ones_ = numbers(p_);
        w_ = numbers(2 * p_), Y_ = numbers(2 * p_);
        iterate_ = {numbers(6 * padded_), numbers(2 * p_)};
        last_ = {numbers(6 * padded_), numbers(2 * p_)};
        before_ = {numbers(6 * padded_), numbers(2 * p_)};
        for (Index j = 0; j < p_; ++j) last_weights_[j] = -1, ones_[j] = 1;
    }

    // Forget the solutions of earlier images.
    void begin() { last_.known = before_.known = false; }

    // Solve and certify an image, and write what the task asks for.
    void solve(Index image) {
        const bool same_mask = reduce_atoms(image);
        if (reduction_.visible_count < 2) return set_degenerate(image);
        reduce_landmarks(image);
        ReducedProgram reduced{atoms_,
                               w_,
                               program_.lam[image] / (units_.dual * units_.atoms),
                               program_.delta,
                               TOLERANCE_SHARE * task_.options.tolerance,
                               task_.options.max_steps};
        const bool near = start(same_mask, reduced.lam);
        Index steps = solve_reduced(image, reduced, near, 0);
        shift_solutions(same_mask);
        write_point(image);
        set_status(image);
        if (task_.end.status[image] == Status::ITERATION_LIMIT &&
            steps < reduced.max_steps) {
            reduced.tolerance *= SECOND_TOLERANCE_SHARE;
            scale_errors_to_solver(image);
            steps += solve_reduced(image, reduced, false, steps);
            store_last();
            write_point(image);
            set_status(image);
        }
        task_.end.steps[image] = steps;
        scale_errors_to_landmarks(image);
        append_transforms(image);
    }

  private:
    // Whether the loss has sparse errors E.
    bool is_robust() const { return program_.bound < INFINITE; }
    // Whether the dual of the loss has the term 1/2 ||Y||^2.
    bool is_quadratic() const { return program_.delta > 0; }
    // Coordinates of the reduced landmarks.
    Index q() const { return reduction_.coordinates(); }

    // Reduce the atoms by the weights of an image, unless these are the last image's;
    // returns whether they are.
    bool reduce_atoms(Index image) {
        const Vector<const double> omega = program_.weights[image];
        if (are_equal(omega.data, last_weights_.data, p_)) return true;
        for (Index j = 0; j < p_; ++j) {
            last_weights_[j] = omega[j];
            // Without a quadratic the weights move from the residual to the bounds of
            // the dual, f(omega r) = omega f(r): the same program, but well conditioned
            // whatever they are.
            rho_[j] = !is_quadratic() && omega[j] > 0 ? 1 : omega[j];
        }
        reduction_.set_weights(rho_);
        if (reduction_.visible_count < 2) return false;
        const double largest = atoms_.reduce(rho_.data, reduction_);
        units_.atoms = largest > 0 ? largest : 1;
        atoms_.scale(1 / units_.atoms);
        work_.begin_atoms(q());
        return false;
    }

    // Reduce the landmarks of an image and scale them to ||w|| = 1; set units and
    // bounds.
    void reduce_landmarks(Index image) {
        const Matrix<const double> W = program_.landmarks[image];
        double total = 0;
        reduction_.reduce_landmarks(W, rho_.data, w_, q());
        for (Index j = 0; j < 2 * q(); ++j) total += square(w_[j]);
        units_.landmarks = total > 0 ? root(total) : 1;
        for (Index j = 0; j < 2 * q(); ++j) w_[j] /= units_.landmarks;
        units_.dual =
            is_quadratic() ? units_.landmarks : program_.lam[image] / units_.atoms;
        for (Index j = 0; j < p_; ++j) {
            const double weight = is_quadratic() ? 1 : last_weights_[j];
            bounds_[j] = program_.bound * weight / units_.dual;
        }
    }

    // Set the first iterate; returns whether it is the solution of a neighbour with the
    // same weights.
    bool start(bool same_mask, double lam) {
        const bool known = last_.known && start_from_last(same_mask);
        if (!known) start_cold(lam);
        return known && same_mask;
    }

    // Start from the last solution, or with the same weights beyond it, along the last
    // two; false where it does not fit the landmarks.
    bool start_from_last(bool same_mask) {
        const bool ahead = same_mask && before_.known;
        for (Index e = 0; e < 6 * padded_; ++e)
            iterate_.M[e] =
                (ahead ? last_.M[e] + EXTRAPOLATION * (last_.M[e] - before_.M[e])
                       : last_.M[e]) /
                units_.transforms();
        if (!fits_landmarks()) return false;
        if (!same_mask)
            for (int a = 0; a < 2; ++a)
                reduction_.reduce(Y_ + a * p_, ones_, last_.y + a * q());
        for (Index j = 0; j < 2 * q(); ++j)
            iterate_.y[j] =
                (ahead ? last_.y[j] + EXTRAPOLATION * (last_.y[j] - before_.y[j])
                       : last_.y[j]) /
                units_.dual;
        return true;
    }

    // Whether ||w - sum M_i B_i||^2 is a small share of ||w||^2.
    bool fits_landmarks() {
        double* left = work_.gradient;
        const Index n = 2 * q();
        memcpy(left, w_, sizeof(double) * n);
        list_active(iterate_.M);
        for (Index c = 0; c < active_.count; ++c)
            subtract_shape(active_.blocks + 6 * c, atoms_[active_.atom[c]], atoms_.row,
                           left, q());
        return dot(left, left, n) < MAX_UNEXPLAINED_SHARE * dot(w_, w_, n);
    }

    // Set `active_` to the transforms of M (6, padded) that are not 0, but for padding.
    void list_active(const double* M) {
        active_.count = 0;
        for (Index i = 0; i < padded_; i += WIDTH) {
            Doubles size = {};
            for (int e = 0; e < 6; ++e) size += magnitude(load(M + e * padded_ + i));
            for (int lane = 0; lane < WIDTH && i + lane < k_; ++lane) {
                active_.atom[active_.count] = i + lane;
                active_.count += size[lane] != 0;
            }
        }
        for (Index c = 0; c < active_.count; ++c)
            for (int e = 0; e < 6; ++e)
                active_.blocks[6 * c + e] = M[e * padded_ + active_.atom[c]];
    }

    // Start from M = 0 and the multiple of w that is dual feasible.
    void start_cold(double lam) {
        memset(iterate_.M, 0, sizeof(double) * 6 * padded_);
        correlate(atoms_.planes, w_, w_ + q(), work_.N);
        const double largest = larger(largest_nuclear_norm(work_.N, padded_), TINY);
        const double scale = smaller(1, lam / largest);
        for (Index j = 0; j < 2 * q(); ++j) iterate_.y[j] = scale * w_[j];
    }

    // Solve from the iterate, after `taken` Newton steps, first as from a good start
    // where `near`; returns how many more steps it took.
    Index solve_reduced(Index image, const ReducedProgram& reduced, bool near,
                        Index taken) {
        if (is_robust()) {
            errors_.attach(reduction_, bounds_, task_.point.errors[image].data);
            return solve_lagrangian(reduced, iterate_, errors_, work_, taken);
        }
        Index steps = 0;
        if (near && is_quadratic()) {
            correlate(atoms_.planes, iterate_.y, iterate_.y + q(), work_.N);
            const PrimalDualEnd end = solve_primal_dual(reduced, iterate_, work_);
            steps = end.steps;
            if (end.solved) return steps;
        }
        return steps +
               solve_lagrangian(reduced, iterate_, NoErrors{}, work_, taken + steps);
    }

    // Store the last solution as the one before it, and the iterate as the last.
    void shift_solutions(bool same_mask) {
        const Memory oldest = before_;
        before_ = last_;
        before_.known &= same_mask;
        last_ = oldest;
        store_last();
    }

    // Store the iterate as the last solution, in the units of the data.
    void store_last() {
        const double scale = units_.transforms();
        for (Index e = 0; e < 6 * padded_; ++e) last_.M[e] = iterate_.M[e] * scale;
        for (Index j = 0; j < 2 * q(); ++j) last_.y[j] = iterate_.y[j] * units_.dual;
        for (int a = 0; a < 2; ++a)
            reduction_.expand(last_.y + a * q(), Y_ + a * p_, p_);
    }

    // Write the dual point Y and the errors E of the last solution, for all landmarks
    // of the image, and set `active_` to its transforms.
    void write_point(Index image) {
        list_active(last_.M);
        for (int a = 0; a < 2; ++a) {
            double *E = task_.point.errors[image][a].data,
                   *Y = task_.point.dual[image][a].data;
            for (Index j = 0; j < p_; ++j) Y[j] = 0;
            for (Index m = 0; m < reduction_.visible_count; ++m) {
                const Index j = reduction_.visible[m];
                const double weight = rho_[j] / last_weights_[j];
                Y[j] = Y_[a * p_ + j] * weight;
                if (is_robust()) E[j] *= units_.landmarks / weight;
            }
        }
    }

    // Certify the image; its gap, and the residual under the exact loss, give the
    // status.
    void set_status(Index image) {
        certifier_.certify(image, active_, task_.point, task_.proof);
        const double gap = magnitude(task_.proof.relative_gap[image]);
        last_.known = is_finite(gap);
        if (!last_.known) {
            task_.end.status[image] = Status::NUMERICAL_FAILURE;
            return;
        }
        const bool exact = !is_quadratic() && !is_robust();
        const double worst = exact ? larger(gap, task_.proof.residual[image]) : gap;
        task_.end.status[image] = worst <= task_.options.tolerance
                                      ? Status::OPTIMAL
                                      : Status::ITERATION_LIMIT;
    }

    // Scale E from the unit of the weighted residual, which certificates use, back to
    // that of the solver.
    void scale_errors_to_solver(Index image) {
        scale_errors(image, [&](Index j) {
            return rho_[j] / last_weights_[j] / units_.landmarks;
        });
    }
    // Scale E from the unit of the weighted residual to that of the landmarks.
    void scale_errors_to_landmarks(Index image) {
        scale_errors(image, [&](Index j) { return 1 / last_weights_[j]; });
    }
    // E_j *= scale(j) of the visible landmarks.
    template <class Scale>
    void scale_errors(Index image, const Scale& scale) {
        if (!is_robust()) return;
        for (int a = 0; a < 2; ++a)
            for (Index m = 0; m < reduction_.visible_count; ++m) {
                const Index j = reduction_.visible[m];
                task_.point.errors[image][a][j] *= scale(j);
            }
    }

    // Append the transforms of the image to the common list of all images.
    void append_transforms(Index image) {
        const Index count = active_.count;
        const Index at =
            __atomic_fetch_add(task_.transforms.used.data, count, __ATOMIC_RELAXED);
        task_.transforms.first[image] = at;
        task_.transforms.count[image] = count;
        memcpy(task_.transforms.atom.data + at, active_.atom, sizeof(int64_t) * count);
        memcpy(task_.transforms.blocks.data + 6 * at, active_.blocks,
               sizeof(double) * 6 * count);
    }

    // Write that too few landmarks of the image are visible to solve anything.
    void set_degenerate(Index image) {
        task_.end.status[image] = Status::DEGENERATE;
        task_.proof.objective[image] = NOT_A_NUMBER;
        task_.proof.relative_gap[image] = NOT_A_NUMBER;
        task_.proof.residual[image] = NOT_A_NUMBER;
    }

    const ConvexTask& task_;
    const ConvexProgram& program_;
    const Index k_, p_;
    Workspace workspace_;
    Certifier certifier_;
    Reduction reduction_;
    const Index padded_;
    ReducedAtoms atoms_;
    SparseErrors errors_;
    NewtonWorkspace work_;
    Vector<double> last_weights_, rho_;
    double *bounds_, *ones_, *w_, *Y_;
    Iterate iterate_;
    Memory last_, before_;
    ActiveList active_;
    Units units_;
};

}  // namespace

// Solve the images of all blocks that begin in the range in turn, and certify each. The
// range may end within a block, which is solved to its end.
void solve_convex(const ConvexTask& task, Range range) {
    const Vector<const bool> begins = task.options.begins;
    const Index images = begins.size[0];
    BlockSolver solver(task);
    for (Index first = range.first; first < range.last; ++first) {
        if (!begins[first]) continue;
        solver.begin();
        solver.solve(first);
        for (Index image = first + 1; image < images && !begins[image]; ++image)
            solver.solve(image);
    }
}

// Certify given transforms and errors of each image of the range.
void certify_images(const CertificateTask& task, Range range) {
    Workspace workspace;
    Certifier certifier(task.program, workspace);
    for (Index image = range.first; image < range.last; ++image) {
        check_interrupt();
        certifier.certify(image, task.transforms[image], task.point, task.proof);
    }
}

const Exported<solve_convex> solve_convex_exported{"solve_convex"};
const Exported<certify_images> certify_exported{"certify"};

}  // namespace shapefit
