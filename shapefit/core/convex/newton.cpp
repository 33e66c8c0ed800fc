#include "newton.hpp"

#include <string.h>

namespace shapefit {

NewtonWorkspace::NewtonWorkspace(Workspace& workspace, Index padded_atoms, Index q,
                                 Index further_rows)
    : active(workspace, padded_atoms),
      gram(workspace, 6 * padded_atoms + further_rows, 2 * q),
      row_system(workspace, padded_atoms),
      N(workspace.zeros<double>(6 * padded_atoms)),
      change(workspace.zeros<double>(6 * padded_atoms)),
      total(workspace.zeros<double>(padded_atoms)),
      gradient(workspace.zeros<double>(2 * q)),
      direction(workspace.zeros<double>(2 * q)),
      moved(workspace.zeros<double>(6 * padded_atoms)),
      weighted(workspace.zeros<double>(6 * padded_atoms)),
      start_M(workspace.zeros<double>(6 * padded_atoms)),
      start_y(workspace.zeros<double>(2 * q)),
      matrix(further_rows > 0 ? workspace.zeros<double>(4 * q * q) : nullptr) {}

void NewtonWorkspace::begin_atoms(Index q) {
    gram.set_unknowns(2 * q);
    row_system.clear();
}

namespace {

// direction = (shift I + sigma sum_i B_i^T W_i B_i)^-1 (gradient + F^T f), f the
// right-hand sides of the directions.
void solve_system(const ReducedProgram& program, double shift, NewtonWorkspace& work) {
    if (work.row_system.solve(work.active, shift, work.gradient, work.direction,
                              program.atoms, work.gram))
        return;
    const Index rows = work.active.write_rows(program.atoms, work.gram);
    work.gram.solve(rows, shift, true, work.gradient, work.direction);
}

// sigma starts at FIRST_SIGMA / lambda, the step on which M can move by its own size
// where ||w|| = 1 and ||B_i|| = 1, and grows by SIGMA_GROWTH per outer iteration.
constexpr double FIRST_SIGMA = 20, SIGMA_GROWTH = 4;
// rho_j bound_j = ERRORS_SHARE sigma lambda: an entry of E has the size of one
// residual, M that of all of w. The count of steps is flat from 0.03 to 0.1, with 12
// landmarks as with 256.
constexpr double ERRORS_SHARE = 0.05;
// An inner problem is solved until ||gradient|| <= INNER_TOLERANCE ||change of (M, E)||
// / (sigma lambda).
constexpr double INNER_TOLERANCE = 2;
// Rounding of the gradient, whose terms M + sigma y B^T and E + rho Y cancel, as a
// share of sigma lambda. No inner problem is solved beyond it, nor in more than
// MAX_INNER_STEPS steps; where one of these comes first sigma falls: the noise grows
// with it, and so do the kinks of phi that a step crosses.
constexpr double ROUNDING = 1e-15;
constexpr Index MAX_INNER_STEPS = 40;
constexpr double ARMIJO = 1e-4, MIN_STEP = 1e-10;

// A proximal point: prox in the active blocks, fresh errors, and what they say of the
// optimum.
struct ProximalPoint {
    double gradient;  // ||gradient of phi||^2
    double moved;     // ||change of (M, E)||^2
    double gap;
};

// The proximal-point method of newton.hpp, on one image.
template <class Errors>
class Lagrangian {
  public:
    Lagrangian(const ReducedProgram& program, Iterate& iterate, Errors& errors,
               NewtonWorkspace& work)
        : program_(program),
          iterate_(iterate),
          errors_(errors),
          work_(work),
          q_(program.q()),
          n_(program.unknowns()),
          k_(program.padded_atoms()),
          sigma_(FIRST_SIGMA / program.lam) {}

    // Run outer iterations until the gap is within the tolerance, or the steps are used
    // up; returns how many Newton steps it took, beside those `taken` before.
    Index solve(Index taken) {
        steps_ = taken;
        for (Inner inner = Inner::SOLVED; inner != Inner::DONE;) {
            correlate(program_.atoms.planes, iterate_.y, iterate_.y + q_, work_.N);
            begin_outer();
            inner = minimise();
            accept();
            sigma_ *= inner == Inner::SOLVED ? SIGMA_GROWTH : 1 / SIGMA_GROWTH;
            if (inner == Inner::DONE || Errors::robust || !(program_.delta > 0))
                continue;
            // the proximal point may be a good start
            const PrimalDualEnd end = solve_primal_dual(program_, iterate_, work_);
            steps_ += end.steps;
            if (end.solved) break;
        }
        return steps_ - taken;
    }

  private:
    // How the minimisation of phi ended: the program is solved or the steps are used
    // up, phi is minimised as far as asked, or rounding stops it.
    enum class Inner { DONE, SOLVED, STUCK };

    // Minimise phi over y by damped Newton steps, at one sigma.
    Inner minimise() {
        for (Index inner = 0;; ++inner, ++steps_) {
            check_interrupt();
            const ProximalPoint point = find_proximal_point();
            if (point.gap <= program_.tolerance || steps_ >= program_.max_steps ||
                !is_finite(point.gap))
                return Inner::DONE;
            const double t = threshold(), noise = ROUNDING * t;
            if (inner > 0 && point.gradient * t * t <=
                                 INNER_TOLERANCE * INNER_TOLERANCE * point.moved)
                return Inner::SOLVED;
            if (inner > 0 &&
                (point.gradient <= noise * noise || inner >= MAX_INNER_STEPS))
                return Inner::STUCK;
            take_newton_step(root(point.gradient));
        }
    }

    // sigma lambda, the threshold of the prox.
    double threshold() const { return sigma_ * program_.lam; }

    // Set phi and its terms at y, for this sigma and M.
    void begin_outer() {
        errors_.begin(ERRORS_SHARE * threshold(), iterate_.y, q_);
        yy_ = dot(iterate_.y, iterate_.y, n_);
        yw_ = dot(iterate_.y, program_.w, n_);
        phi_ = value_along(0);
    }

    // phi(y + step direction); sets work_.total to the sums of singular values there.
    double value_along(double step) {
        const double part = moreau(iterate_.M, work_.N, step, work_.change, sigma_,
                                   threshold(), work_.total, k_);
        const double square = 0.5 * yy_ + step * yd_ + 0.5 * step * step * dd_;
        return program_.delta * square - yw_ - step * wd_ + part / (2 * sigma_) +
               errors_.value(step);
    }

    // Find the proximal point of M and E at y, and the gradient delta y - w +
    // sum P_i B_i + errors, in work_.gradient.
    ProximalPoint find_proximal_point() {
        ActiveBlocks& active = work_.active;
        double* g = work_.gradient;
        active.find(iterate_.M, work_.N, sigma_, threshold(), work_.total, k_);
        for (Index j = 0; j < n_; ++j)
            g[j] = program_.w[j] - program_.delta * iterate_.y[j];
        active.subtract_fit(program_.atoms, g, g + q_, q_);
        for (Index j = 0; j < n_; ++j) g[j] = -g[j];
        const ErrorsPoint errors = errors_.find(g, q_);
        ProximalPoint point;
        point.gradient = dot(g, g, n_);
        point.moved = moved_transforms() + errors.moved;
        point.gap = relative_gap(errors.share, point.gradient);
        return point;
    }

    // sum_i ||prox_i - M_i||^2.
    double moved_transforms() const {
        const ActiveBlocks& active = work_.active;
        double moved = 0;
        for (int e = 0; e < 6; ++e) {
            const double* row = iterate_.M + e * k_;
            for (Index i = 0; i < k_; ++i)
                moved += work_.total[i] > threshold() ? 0 : square(row[i]);
            for (Index c = 0; c < active.count; ++c)
                moved += square(active.prox[e * k_ + c] - row[active.index[c]]);
        }
        return moved;
    }

    // The relative gap of the proximal point to the dual bound by y; `share` is the
    // largest of |y| over its bound, `gradient` the square of the norm.
    double relative_gap(double share, double gradient) {
        const bool quadratic = program_.delta > 0;
        double residual = 0;
        for (Index j = 0; j < n_; ++j)
            residual += square(program_.delta * iterate_.y[j] - work_.gradient[j]);
        const double primal = program_.lam * work_.active.norms +
                              errors_.penalty(work_.gradient, q_, quadratic) +
                              program_.delta * 0.5 * residual;
        const DualBound bound(program_.lam, program_.delta,
                              largest_nuclear_norm(work_.N, k_), share, yy_, yw_);
        const double gap = bound.relative_gap(primal);
        return !quadratic && !Errors::robust ? larger(gap, root(gradient)) : gap;
    }

    // y += step d along Newton's direction, step halved until phi falls (Armijo);
    // `gradient` is the norm of the gradient.
    void take_newton_step(double gradient) {
        find_direction(gradient);
        double* d = work_.direction;
        correlate(program_.atoms.planes, d, d + q_, work_.change);
        errors_.set_direction(d, q_);
        const double slope = dot(work_.gradient, d, n_);
        yd_ = dot(iterate_.y, d, n_), dd_ = dot(d, d, n_), wd_ = dot(program_.w, d, n_);
        const auto falls = [&](double step, double value) {
            return value <= phi_ + ARMIJO * step * slope + 1e-13 * magnitude(phi_);
        };
        double step = 1, value = value_along(step);
        while (!falls(step, value) && !(step < MIN_STEP))
            value = value_along(step *= 0.5);
        phi_ = value;
        for (Index j = 0; j < n_; ++j) iterate_.y[j] += step * d[j];
        for (Index e = 0; e < 6 * k_; ++e) work_.N[e] += step * work_.change[e];
        errors_.step(step);
        yy_ = dot(iterate_.y, iterate_.y, n_);
        yw_ = dot(iterate_.y, program_.w, n_);
        yd_ = dd_ = wd_ = 0;
    }

    // d = -(shift I + sum sigma B_i^T D_i B_i + errors)^-1 gradient.
    void find_direction(double gradient) {
        ActiveBlocks& active = work_.active;
        ShiftedGram& gram = work_.gram;
        const bool quadratic = program_.delta > 0;
        active.weigh(threshold(), Weighing::derivative);
        active.find_directions(sigma_, nullptr);
        const double shift =
            quadratic ? program_.delta : sigma_ * (1e-13 + 1e-7 * smaller(1, gradient));
        if (quadratic && !Errors::robust) {
            solve_system(program_, shift, work_);
            return negate_direction();
        }
        const Index rows = active.write_rows(program_.atoms, gram);
        const Index curved = errors_.count_curved();
        if (curved > 0 && !(quadratic && rows + curved < n_)) {
            errors_.write_matrix(shift, work_.matrix);
            gram.solve(rows, work_.matrix, work_.gradient, work_.direction);
        } else {
            errors_.append_rows(rows, gram);
            gram.solve(rows + curved, shift, quadratic, work_.gradient,
                       work_.direction);
        }
        negate_direction();
    }

    // d <- -d for Newton's direction.
    void negate_direction() {
        for (Index j = 0; j < n_; ++j) work_.direction[j] = -work_.direction[j];
    }

    // Set M and E to the proximal point.
    void accept() {
        const ActiveBlocks& active = work_.active;
        memset(iterate_.M, 0, sizeof(double) * 6 * k_);
        for (int e = 0; e < 6; ++e)
            for (Index c = 0; c < active.count; ++c)
                iterate_.M[e * k_ + active.index[c]] = active.prox[e * k_ + c];
        errors_.accept();
    }

    const ReducedProgram& program_;
    Iterate& iterate_;
    Errors& errors_;
    NewtonWorkspace& work_;
    const Index q_, n_, k_;
    double sigma_;
    Index steps_ = 0;
    double phi_ = 0, yy_ = 0, yw_ = 0;  // at y
    double yd_ = 0, dd_ = 0, wd_ = 0;   // with the direction
};

}  // namespace

Index solve_lagrangian(const ReducedProgram& program, Iterate& iterate, NoErrors errors,
                       NewtonWorkspace& work, Index taken) {
    return Lagrangian<NoErrors>(program, iterate, errors, work).solve(taken);
}

Index solve_lagrangian(const ReducedProgram& program, Iterate& iterate,
                       SparseErrors& errors, NewtonWorkspace& work, Index taken) {
    return Lagrangian<SparseErrors>(program, iterate, errors, work).solve(taken);
}

namespace {

// sigma lambda: the count of steps is flat from 0.3 to 4.
constexpr double SIGMA_LAMBDA = 1;
constexpr Index MAX_ROUNDS = 8;
// The gap of a start from which the steps diverge: soon nearly all atoms are active,
// and each step costs many times what the augmented Lagrangian asks. Attempts that
// converge stay below 0.9. This and the start that is put back in the end are for
// speed: the certificate judges either solver.
constexpr double MAX_START_GAP = 0.95;

// Set up the Newton step on M and y: the active blocks with their weights and
// directions, work.moved = P_i - M_i, and work.gradient = w - y - sum P_i B_i.
void build_system(const ReducedProgram& program, const Iterate& iterate, double sigma,
                  NewtonWorkspace& work) {
    const Index k = program.padded_atoms(), n = program.unknowns();
    ActiveBlocks& active = work.active;
    sum_singular_values(iterate.M, work.N, sigma, work.total, k);
    active.find(iterate.M, work.N, sigma, sigma * program.lam, work.total, k);
    active.weigh(sigma * program.lam, Weighing::resolvent);
    for (int e = 0; e < 6; ++e)
        for (Index c = 0; c < active.count; ++c)
            work.moved[e * k + c] =
                active.prox[e * k + c] - iterate.M[e * k + active.index[c]];
    for (Index j = 0; j < n; ++j) work.gradient[j] = program.w[j] - iterate.y[j];
    active.subtract_fit(program.atoms, work.gradient, work.gradient + program.q(),
                        program.q());
    active.find_directions(sigma, work.moved);
}

// M_i <- P_i + W_i (sigma dN_i + P_i - M_i), dN = fresh_N - N; returns sum ||M_i||_2.
double move_transforms(const ReducedProgram& program, double sigma,
                       const double* fresh_N, Iterate& iterate, NewtonWorkspace& work) {
    const Index k = program.padded_atoms();
    const ActiveBlocks& active = work.active;
    for (int e = 0; e < 6; ++e)
        for (Index c = 0; c < active.count; ++c) {
            const Index at = e * k + active.index[c];
            work.moved[e * k + c] += sigma * (fresh_N[at] - work.N[at]);
        }
    active.apply_weights(work.moved, work.weighted);
    memset(iterate.M, 0, sizeof(double) * 6 * k);
    double norms = 0;
    for (Index c = 0; c < active.count; c += WIDTH) {
        BlockLanes M = load_blocks(work.weighted, k, c);
        for (int e = 0; e < 6; ++e) M.q[e] += load(active.prox + e * k + c);
        for (int e = 0; e < 6; ++e) store(work.weighted + e * k + c, M.q[e]);
        const Doubles sizes = spectral_norm(invariants(M.q));
        for (int lane = 0; lane < WIDTH && c + lane < active.count; ++lane)
            norms += sizes[lane];
    }
    for (int e = 0; e < 6; ++e)
        for (Index c = 0; c < active.count; ++c)
            iterate.M[e * k + active.index[c]] = work.weighted[e * k + c];
    return norms;
}

}  // namespace

PrimalDualEnd solve_primal_dual(const ReducedProgram& program, Iterate& iterate,
                                NewtonWorkspace& work) {
    const Index k = program.padded_atoms(), q = program.q(), n = program.unknowns();
    const double sigma = SIGMA_LAMBDA / program.lam;
    memcpy(work.start_M, iterate.M, sizeof(double) * 6 * k);
    memcpy(work.start_y, iterate.y, sizeof(double) * n);
    Index steps = 0;
    while (steps < MAX_ROUNDS && steps < program.max_steps) {
        check_interrupt();
        build_system(program, iterate, sigma, work);
        solve_system(program, 1, work);
        for (Index j = 0; j < n; ++j) iterate.y[j] += work.direction[j];
        correlate(program.atoms.planes, iterate.y, iterate.y + q, work.change);
        const double norms =
            move_transforms(program, sigma, work.change, iterate, work);
        double* fresh = work.change;
        work.change = work.N;
        work.N = fresh;
        ++steps;
        const double yy = dot(iterate.y, iterate.y, n),
                     yw = dot(iterate.y, program.w, n);
        const DualBound bound(program.lam, 1, largest_nuclear_norm(work.N, k), 0, yy,
                              yw);
        const double gap = bound.relative_gap(0.5 * yy + program.lam * norms);
        if (gap <= program.tolerance) return {steps, true};
        if (!(gap < MAX_START_GAP)) break;
    }
    memcpy(iterate.M, work.start_M, sizeof(double) * 6 * k);
    memcpy(iterate.y, work.start_y, sizeof(double) * n);
    return {steps, false};
}

}  // namespace shapefit
