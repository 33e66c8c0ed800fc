// A stretch of images, each solved from its neighbour's solution where that explains it.
#include <string.h>

#include "../base/registry.hpp"
#include "certificate.hpp"
#include "newton.hpp"

namespace shapefit {

namespace {

// The solver aims a little below the tolerance, so that the certificate in the units of the data,
// which rounds differently, agrees with it. This saves a second round, and decides nothing else.
constexpr double CLOSER = 0.99;
// Where it does not, as with weights over six orders at a gap of 1e-10, the solver goes on once, to
// this share of the tolerance.
constexpr double STILL_CLOSER = 0.1;
// A neighbour's transforms are a start where they leave less than this share of ||w||^2.
constexpr double EXPLAINED = 0.1;
// The start goes on from the last two solutions by this share of their difference.
constexpr double AHEAD = 0.5;

// Sizes of the reduced units: ||w||, max ||B_i|| and the unit of the dual.
struct Units {
    double landmarks = 1, atoms = 1, dual = 1;
    double transforms() const { return landmarks / atoms; }
};

// The transforms of an image that are not 0.
struct ActiveList {
    int64_t* atom;
    double* blocks;
    long count = 0;
    operator ImageTransforms() const { return {atom, blocks, count}; }
};

// A solution in the units of the data, and whether there is one.
struct Memory {
    double *M, *y;
    bool known = false;
};

class StretchSolver {
  public:
    explicit StretchSolver(const ConvexTask& task)
        : task_(task),
          program_(task.program),
          k_(program_.atoms.size[0]),
          p_(program_.atoms.size[2]),
          certifier_(program_, workspace_),
          reduction_(workspace_, p_),
          padded_(certifier_.planes.padded_atoms),
          atoms_(workspace_, certifier_.planes, padded_),
          errors_(workspace_, p_),
          room_(workspace_, padded_, p_ > 1 ? p_ - 1 : 1, robust() ? 2 * p_ : 0) {
        const auto numbers = [&](long count) { return workspace_.zeros<double>(count); };
        active_ = {workspace_.zeros<int64_t>(padded_ + 1), numbers(6 * padded_)};
        last_weights_ = workspace_.vector<double>(p_);
        rho_ = workspace_.vector<double>(p_);
        bounds_ = numbers(p_), ones_ = numbers(p_), row_ = numbers(p_);
        w_ = numbers(2 * p_), Y_ = numbers(2 * p_);
        iterate_ = {numbers(6 * padded_), numbers(2 * p_)};
        last_ = {numbers(6 * padded_), numbers(2 * p_)};
        before_ = {numbers(6 * padded_), numbers(2 * p_)};
        for (long j = 0; j < p_; ++j) last_weights_[j] = -1, ones_[j] = 1;
    }

    // Solve as if nothing came before.
    void begin() { last_.known = before_.known = false; }

    void solve(long image) {
        const bool same_mask = take_weights(image);
        if (reduction_.seen < 2) return give_up(image);
        take_landmarks(image);
        ReducedProgram reduced{atoms_, w_,
                               program_.lam[image] / (units_.dual * units_.atoms), program_.delta,
                               CLOSER * task_.options.tolerance, task_.options.most_steps};
        const bool near = start(same_mask, reduced.lam);
        long steps = solve_reduced(image, reduced, near, 0);
        remember(same_mask);
        write(image);
        judge(image);
        if (task_.end.status[image] == Status::ITERATION_LIMIT && steps < reduced.most_steps) {
            reduced.tolerance *= STILL_CLOSER;
            take_errors_back(image);
            steps += solve_reduced(image, reduced, false, steps);
            keep();
            write(image);
            judge(image);
        }
        task_.end.steps[image] = steps;
        give_errors_their_unit(image);
        hand_over(image);
    }

  private:
    bool robust() const { return program_.bound < INFINITE; }
    bool quadratic() const { return program_.delta > 0; }
    long q() const { return reduction_.coordinates(); }

    // Reduce the atoms where the weights are not the last image's; returns whether they are.
    bool take_weights(long image) {
        const Vector<const double> omega = program_.weights[image];
        if (are_equal(omega.data, last_weights_.data, p_)) return true;
        for (long j = 0; j < p_; ++j) {
            last_weights_[j] = omega[j];
            // Without a quadratic the weights move from the residual to the bounds of the dual,
            // f(omega r) = omega f(r): the same program, but well conditioned whatever they are.
            rho_[j] = !quadratic() && omega[j] > 0 ? 1 : omega[j];
        }
        reduction_.find(rho_);
        if (reduction_.seen < 2) return false;
        const double largest = atoms_.reduce(rho_.data, reduction_);
        units_.atoms = largest > 0 ? largest : 1;
        atoms_.scale(1 / units_.atoms);
        room_.gram.set_unknowns(2 * q());
        return false;
    }

    void take_landmarks(long image) {
        const Matrix<const double> W = program_.landmarks[image];
        double total = 0;
        reduction_.reduce_landmarks(W, rho_.data, w_, q());
        for (long j = 0; j < 2 * q(); ++j) total += square(w_[j]);
        units_.landmarks = total > 0 ? root(total) : 1;
        for (long j = 0; j < 2 * q(); ++j) w_[j] /= units_.landmarks;
        units_.dual = quadratic() ? units_.landmarks : program_.lam[image] / units_.atoms;
        for (long j = 0; j < p_; ++j) {
            const double weight = quadratic() ? 1 : last_weights_[j];
            bounds_[j] = program_.bound * weight / units_.dual;
        }
    }

    // The first iterate; returns whether it is the solution of a neighbour with the same weights.
    bool start(bool same_mask, double lam) {
        const bool known = last_.known && start_from_last(same_mask);
        if (!known) start_cold(lam);
        return known && same_mask;
    }

    bool start_from_last(bool same_mask) {
        const bool ahead = same_mask && before_.known;
        for (long e = 0; e < 6 * padded_; ++e)
            iterate_.M[e] =
                (ahead ? last_.M[e] + AHEAD * (last_.M[e] - before_.M[e]) : last_.M[e]) /
                units_.transforms();
        if (!explains()) return false;
        if (!same_mask)
            for (int a = 0; a < 2; ++a)
                reduction_.reduce(Y_ + a * p_, ones_, last_.y + a * q());
        for (long j = 0; j < 2 * q(); ++j)
            iterate_.y[j] = (ahead ? last_.y[j] + AHEAD * (last_.y[j] - before_.y[j]) : last_.y[j]) /
                            units_.dual;
        return true;
    }

    // Whether ||w - sum M_i B_i||^2 is a small share of ||w||^2.
    bool explains() {
        double* left = room_.gradient;
        const long n = 2 * q();
        memcpy(left, w_, sizeof(double) * n);
        list_active(iterate_.M);
        for (long c = 0; c < active_.count; ++c)
            subtract_shape(active_.blocks + 6 * c, atoms_[active_.atom[c]], atoms_.row, left, q());
        return dot(left, left, n) < EXPLAINED * dot(w_, w_, n);
    }

    // Those of the transforms M (6, padded) that are not 0; beyond the atoms nothing counts.
    void list_active(const double* M) {
        active_.count = 0;
        for (long i = 0; i < padded_; i += WIDTH) {
            Doubles size = {};
            for (int e = 0; e < 6; ++e) size += magnitude(load(M + e * padded_ + i));
            for (int lane = 0; lane < WIDTH && i + lane < k_; ++lane) {
                active_.atom[active_.count] = i + lane;
                active_.count += size[lane] != 0;
            }
        }
        for (long c = 0; c < active_.count; ++c)
            for (int e = 0; e < 6; ++e)
                active_.blocks[6 * c + e] = M[e * padded_ + active_.atom[c]];
    }

    // M = 0 and the multiple of w that is dual feasible.
    void start_cold(double lam) {
        memset(iterate_.M, 0, sizeof(double) * 6 * padded_);
        correlate(atoms_.planes, w_, w_ + q(), room_.N);
        const double largest = larger(largest_nuclear_norm(room_.N, padded_), TINY);
        const double scale = smaller(1, lam / largest);
        for (long j = 0; j < 2 * q(); ++j) iterate_.y[j] = scale * w_[j];
    }

    // Newton steps, `taken` of which came before.
    long solve_reduced(long image, const ReducedProgram& reduced, bool near, long taken) {
        if (robust()) {
            errors_.attach(reduction_, bounds_, task_.point.errors[image].data);
            return solve_lagrangian(reduced, iterate_, errors_, room_, taken);
        }
        long steps = 0;
        if (near && quadratic()) {
            correlate(atoms_.planes, iterate_.y, iterate_.y + q(), room_.N);
            const PrimalDualEnd end = solve_primal_dual(reduced, iterate_, room_);
            steps = end.steps;
            if (end.solved) return steps;
        }
        return steps + solve_lagrangian(reduced, iterate_, NoErrors{}, room_, taken + steps);
    }

    void remember(bool same_mask) {
        const Memory oldest = before_;
        before_ = last_;
        before_.known &= same_mask;
        last_ = oldest;
        keep();
    }

    // The iterate as the last solution.
    void keep() {
        const double scale = units_.transforms();
        for (long e = 0; e < 6 * padded_; ++e) last_.M[e] = iterate_.M[e] * scale;
        for (long j = 0; j < 2 * q(); ++j) last_.y[j] = iterate_.y[j] * units_.dual;
        for (int a = 0; a < 2; ++a) reduction_.expand(last_.y + a * q(), Y_ + a * p_, p_);
    }

    // Back to the landmarks of the image.
    void write(long image) {
        list_active(last_.M);
        for (int a = 0; a < 2; ++a) {
            double *E = task_.point.errors[image][a].data, *Y = task_.point.dual[image][a].data;
            for (long j = 0; j < p_; ++j) Y[j] = 0;
            for (long m = 0; m < reduction_.seen; ++m) {
                const long j = reduction_.visible[m];
                const double weight = rho_[j] / last_weights_[j];
                Y[j] = Y_[a * p_ + j] * weight;
                if (robust()) E[j] *= units_.landmarks / weight;
            }
        }
    }

    void judge(long image) {
        certifier_.certify(image, active_, task_.point, task_.proof);
        const double gap = magnitude(task_.proof.relative_gap[image]);
        last_.known = is_finite(gap);
        if (!last_.known) {
            task_.end.status[image] = Status::NUMERICAL_FAILURE;
            return;
        }
        const bool exact = !quadratic() && !robust();
        const double judged = exact ? larger(gap, task_.proof.residual[image]) : gap;
        task_.end.status[image] = judged <= task_.options.tolerance ? Status::OPTIMAL : Status::ITERATION_LIMIT;
    }

    // E, in the units of the residual after `judge`, in those of the solver, and in the landmarks'.
    void take_errors_back(long image) {
        scale_errors(image, [&](long j) { return rho_[j] / last_weights_[j] / units_.landmarks; });
    }
    void give_errors_their_unit(long image) {
        scale_errors(image, [&](long j) { return 1 / last_weights_[j]; });
    }
    template <class Scale>
    void scale_errors(long image, const Scale& scale) {
        if (!robust()) return;
        for (int a = 0; a < 2; ++a)
            for (long m = 0; m < reduction_.seen; ++m) {
                const long j = reduction_.visible[m];
                task_.point.errors[image][a][j] *= scale(j);
            }
    }

    // Take as many places of the common list as there are transforms, and fill them.
    void hand_over(long image) {
        const long count = active_.count;
        const long at = __atomic_fetch_add(task_.transforms.used.data, count, __ATOMIC_RELAXED);
        task_.transforms.first[image] = at;
        task_.transforms.count[image] = count;
        memcpy(task_.transforms.atom.data + at, active_.atom, sizeof(int64_t) * count);
        memcpy(task_.transforms.blocks.data + 6 * at, active_.blocks, sizeof(double) * 6 * count);
    }

    void give_up(long image) {
        task_.end.status[image] = Status::DEGENERATE;
        task_.proof.objective[image] = NOT_A_NUMBER;
        task_.proof.relative_gap[image] = NOT_A_NUMBER;
        task_.proof.residual[image] = NOT_A_NUMBER;
    }

    const ConvexTask& task_;
    const ConvexProgram& program_;
    const long k_, p_;
    Workspace workspace_;
    Certifier certifier_;
    Reduction reduction_;
    const long padded_;
    ReducedAtoms atoms_;
    SparseErrors errors_;
    Room room_;
    Vector<double> last_weights_, rho_;
    double *bounds_, *ones_, *row_, *w_, *Y_;
    Iterate iterate_;
    Memory last_, before_;
    ActiveList active_;
    Units units_;
};

}  // namespace

// Solve the images of the range in turn, stretch by stretch, and certify each.
void solve_convex(const ConvexTask& task, Range range) {
    StretchSolver stretch(task);
    for (long image = range.first; image < range.last; ++image) {
        if (image % STRETCH == 0) stretch.begin();
        stretch.solve(image);
    }
}

const Exported<solve_convex> solve_convex_exported{"solve_convex"};

}  // namespace shapefit
