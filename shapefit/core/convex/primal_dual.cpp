#include "primal_dual.hpp"

#include <string.h>

#include "blocks.hpp"

namespace shapefit {
namespace {

// sigma lambda: the count of steps is flat from 0.3 to 4.
constexpr double STEP = 1;
constexpr long MOST_ROUNDS = 8;
// The gap of a start from which the steps diverge: soon nearly all atoms are active, and each step
// costs many times what the augmented Lagrangian asks. Attempts that converge stay below 0.9.
// This and the start that is put back in the end are for speed: the certificate judges either solver.
constexpr double HOPELESS = 0.95;

// The right-hand side w - y - sum P_i B_i, and the rest of it in the rows of F.
long build_system(const ReducedProgram& program, const Iterate& iterate, double sigma, Room& room) {
    const long k = program.padded_atoms(), n = program.unknowns();
    ActiveBlocks& active = room.active;
    sum_singular_values(iterate.M, room.N, sigma, room.total, k);
    active.find(iterate.M, room.N, sigma, sigma * program.lam, room.total, k);
    active.weigh(sigma * program.lam, Weighing::resolvent);
    for (int e = 0; e < 6; ++e)
        for (long c = 0; c < active.count; ++c)
            room.moved[e * k + c] = active.prox[e * k + c] - iterate.M[e * k + active.index[c]];
    for (long j = 0; j < n; ++j) room.gradient[j] = program.w[j] - iterate.y[j];
    active.subtract_fit(program.atoms, room.gradient, room.gradient + program.q(), program.q());
    return active.write_rows(sigma, program.atoms, room.moved, room.gram);
}

// M_i <- P_i + W_i (sigma dN_i + P_i - M_i); returns sum ||M_i||_2.
double move_transforms(const ReducedProgram& program, double sigma, const double* fresh_N,
                       Iterate& iterate, Room& room) {
    const long k = program.padded_atoms();
    const ActiveBlocks& active = room.active;
    for (int e = 0; e < 6; ++e)
        for (long c = 0; c < active.count; ++c) {
            const long at = e * k + active.index[c];
            room.moved[e * k + c] += sigma * (fresh_N[at] - room.N[at]);
        }
    active.apply_weights(room.moved, room.weighted);
    memset(iterate.M, 0, sizeof(double) * 6 * k);
    double norms = 0;
    for (long c = 0; c < active.count; c += WIDTH) {
        BlockLanes M = load_blocks(room.weighted, k, c);
        for (int e = 0; e < 6; ++e) M.q[e] += load(active.prox + e * k + c);
        for (int e = 0; e < 6; ++e) store(room.weighted + e * k + c, M.q[e]);
        const Doubles sizes = spectral_norm(invariants(M.q));
        for (int lane = 0; lane < WIDTH && c + lane < active.count; ++lane) norms += sizes[lane];
    }
    for (int e = 0; e < 6; ++e)
        for (long c = 0; c < active.count; ++c)
            iterate.M[e * k + active.index[c]] = room.weighted[e * k + c];
    return norms;
}

// (P - D) / P where y = w - sum M_i B_i holds, and y is scaled until it is feasible.
double relative_gap(const ReducedProgram& program, const double* y, const double* N, double norms) {
    const long n = program.unknowns();
    const double yy = dot(y, y, n), yw = dot(y, program.w, n);
    const double primal = 0.5 * yy + program.lam * norms;
    const double largest = largest_nuclear_norm(N, program.padded_atoms());
    const double scale = smaller(program.lam / larger(largest, TINY), yw / larger(yy, TINY));
    const double feasible = larger(scale, 0);
    const double dual = feasible * yw - 0.5 * feasible * feasible * yy;
    return magnitude(primal - dual) / larger(primal, TINY);
}

}  // namespace

PrimalDualEnd solve_primal_dual(const ReducedProgram& program, Iterate& iterate, Room& room) {
    const long k = program.padded_atoms(), q = program.q(), n = program.unknowns();
    const double sigma = STEP / program.lam;
    memcpy(room.start_M, iterate.M, sizeof(double) * 6 * k);
    memcpy(room.start_y, iterate.y, sizeof(double) * n);
    long steps = 0;
    while (steps < MOST_ROUNDS && steps < program.most_steps) {
        const long rows = build_system(program, iterate, sigma, room);
        room.gram.solve(rows, 1, true, room.gradient, room.direction);
        for (long j = 0; j < n; ++j) iterate.y[j] += room.direction[j];
        correlate(program.planes, iterate.y, iterate.y + q, room.change);
        const double norms = move_transforms(program, sigma, room.change, iterate, room);
        double* fresh = room.change;
        room.change = room.N;
        room.N = fresh;
        ++steps;
        const double gap = relative_gap(program, iterate.y, room.N, norms);
        if (gap <= program.tolerance) return {steps, true};
        if (!(gap < HOPELESS)) break;
    }
    memcpy(iterate.M, room.start_M, sizeof(double) * 6 * k);
    memcpy(iterate.y, room.start_y, sizeof(double) * n);
    return {steps, false};
}

}  // namespace shapefit
