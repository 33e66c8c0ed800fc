"""The fast solver: semismooth Newton on the augmented dual, one image at a time.

The dual of the program in the reduced coordinates (reduction_kernels.py) is

    max_Y <Y, W> - delta/2 ||Y||_F^2   s.t.  ||Y B_i^T||_* <= lambda,  |Y| <= bound,

delta = 1 for a loss with a quadratic and 0 without. The proximal-point method on the primal
(equivalently the augmented Lagrangian method on the dual) repeats, with growing sigma,

    Y <- argmin phi(Y) = delta/2 ||Y||^2 - <Y, W>
                         + 1/(2 sigma) sum_i ||prox_{sigma lambda}(M_i + sigma Y B_i^T)||^2
                         + sum_j 1/(2 rho_j) ||soft_{rho_j bound_j}(E_j + rho_j Y_j)||^2
    M_i <- prox_{sigma lambda}(M_i + sigma Y B_i^T)
    E_j <- soft_{rho_j bound_j}(E_j + rho_j Y_j)

for columns E_j and Y_j. rho_j bound_j is the same part of sigma lambda for all j, so that the steps
of E and M fit the sizes of both, whatever the bounds and lambda. phi is convex with a semismooth
gradient and lives in 2 (p - 1) dimensions, so a Newton step costs one small Cholesky factorisation
and few steps suffice. Every iterate carries its duality gap.
"""

from __future__ import annotations

import numpy as np

from shapefit.convex.block_kernels import (
    correlate,
    jacobian_rows,
    largest_nuclear_norm,
    moreau,
    prox_block,
)
from shapefit.convex.kernel import kernel
from shapefit.convex.linear_kernels import newton_direction
from shapefit.convex.reduction_kernels import expand_rows

# sigma starts at START / lambda, the step on which M can move by its own size where ||W|| = 1 and
# ||B_i|| = 1, and grows by GROWTH an outer iteration.
START, GROWTH = 20.0, 4.0
# rho_j bound_j = PART sigma lambda: an entry of E has the size of one residual, M that of all of W.
# The count of steps is flat from 0.03 to 0.1, with 12 landmarks as with 256.
PART = 0.05
# An inner problem is solved until ||gradient|| <= LOOSENESS ||change of (M, E)|| / (sigma lambda).
LOOSENESS = 2.0
# Rounding of the gradient, whose terms M + sigma Y B^T and E + rho Y cancel, as a share of sigma
# lambda. No inner problem is solved beyond it, nor in more than PATIENCE steps; where one of these
# comes first sigma falls: the noise grows with it, and so do the kinks of phi that a step crosses.
ROUNDING, PATIENCE = 1e-15, 40
ARMIJO, SHORTEST = 1e-4, 1e-10


@kernel
def soft_squared(E, Y, step, D, rho, threshold):
    """sum_aj soft(E_aj + rho_j (Y_aj + step D_aj))^2 / rho_j; E, Y, D (2, p), rho (p,)."""
    value = 0.0
    for a in range(2):
        for j in range(E.shape[1]):
            excess = abs(E[a, j] + rho[j] * (Y[a, j] + step * D[a, j])) - threshold
            if excess > 0.0:
                value += excess * excess / rho[j]
    return value


@kernel
def solve_reduced(
    W,
    planes,
    atoms,
    lam,
    delta,
    robust,
    bounds,
    visible,
    h,
    tolerance,
    most,
    M,
    E,
    y,
):
    """Solve one image from the start (M, E, y), which are overwritten; returns Newton steps.

    W and y (2, q) with ||W|| = 1; planes (3, q, k) and atoms (k, 3, q) hold the reduced B, the
    largest ||B_i|| being 1; M (6, k); E (2, p) in landmark space and its `bounds` (p,) are used
    only by the robust losses.
    """
    q, k, p = planes.shape[1], planes.shape[2], E.shape[1]
    seen = q + 1
    N, dN = np.zeros((6, k)), np.zeros((6, k))
    total = np.empty(k)
    active, fresh = np.empty(k, np.int64), np.empty((k, 6))
    argument = np.empty(6)
    Y, D = np.zeros((2, p)), np.zeros((2, p))
    fresh_E, rho = np.zeros((2, p)), np.ones(p)
    g, d = np.empty(2 * q), np.empty(2 * q)
    curvature = np.zeros((2, seen if robust else 0))
    F = np.zeros((6 * k + curvature.size, 2 * q))
    H, small = np.empty((2 * q, 2 * q)), np.empty(2 * q)

    sigma = START / lam

    correlate(y, planes, N)
    steps = 0
    while True:
        t, threshold = sigma * lam, PART * sigma * lam
        inner = 0
        if robust:
            for m in range(seen):
                rho[visible[m]] = threshold / bounds[visible[m]]
            expand_rows(y, visible, h, seen, Y)
        yy, yw = 0.0, 0.0
        for j in range(q):
            yy += y[0, j] ** 2 + y[1, j] ** 2
            yw += y[0, j] * W[0, j] + y[1, j] * W[1, j]
        phi = delta * 0.5 * yy - yw + moreau(M, N, 0.0, N, sigma, t, total) / (2.0 * sigma)
        if robust:
            phi += 0.5 * soft_squared(E, Y, 0.0, Y, rho, threshold)
        while True:
            # gradient, with the proximal point it belongs to
            for a in range(2):
                for j in range(q):
                    g[a * q + j] = delta * y[a, j] - W[a, j]
            count, moved, norms = 0, 0.0, 0.0
            for i in range(k):
                if total[i] > t:
                    active[count] = i
                    new = fresh[count]
                    for b in range(6):
                        argument[b] = M[b, i] + sigma * N[b, i]
                    norms += prox_block(argument, t, new)
                    g0, g1 = g[:q], g[q:]
                    B0, B1, B2 = atoms[i, 0], atoms[i, 1], atoms[i, 2]
                    m0, m1, m2, m3, m4, m5 = new[0], new[1], new[2], new[3], new[4], new[5]
                    for j in range(q):
                        g0[j] += m0 * B0[j] + m1 * B1[j] + m2 * B2[j]
                        g1[j] += m3 * B0[j] + m4 * B1[j] + m5 * B2[j]
                    for b in range(6):
                        moved += (new[b] - M[b, i]) ** 2
                    count += 1
                else:
                    for b in range(6):
                        moved += M[b, i] ** 2
            penalty, share = lam * norms, 0.0
            if robust:
                for a in range(2):
                    along = 0.0
                    for m in range(seen):
                        j = visible[m]
                        value = E[a, j] + rho[j] * Y[a, j]
                        excess = abs(value) - threshold
                        fresh_E[a, j] = np.sign(value) * excess if excess > 0.0 else 0.0
                        along += fresh_E[a, j] * h[m]
                        moved += (fresh_E[a, j] - E[a, j]) ** 2
                        share = max(share, abs(Y[a, j]) / bounds[j])
                    for m in range(q):
                        g[a * q + m] += fresh_E[a, visible[m]] - along * h[m]
            gg, rr = 0.0, 0.0
            for a in range(2):
                for j in range(q):
                    gg += g[a * q + j] ** 2
                    rr += (delta * y[a, j] - g[a * q + j]) ** 2
            # duality gap of the proximal point and of y, scaled to be feasible
            if robust:
                if delta > 0.0:
                    for a in range(2):
                        for j in range(p):
                            penalty += bounds[j] * abs(fresh_E[a, j])
                else:
                    expand_rows(-g.reshape(2, q), visible, h, seen, D)
                    for a in range(2):
                        for j in range(p):
                            penalty += bounds[j] * abs(fresh_E[a, j] + D[a, j])
            primal = penalty + delta * 0.5 * rr
            feasible = lam / max(largest_nuclear_norm(N), 1e-300)
            if robust:
                feasible = min(feasible, 1.0 / max(share, 1e-300))
            if delta > 0.0:
                feasible = min(feasible, yw / max(yy, 1e-300))
            dual = max(feasible, 0.0) * yw - delta * 0.5 * feasible * feasible * yy
            gap = abs(primal - dual) / max(primal, 1e-300)
            if delta == 0.0 and not robust:
                gap = max(gap, np.sqrt(gg))
            if gap <= tolerance or steps >= most or not gap < np.inf:
                break
            noise = ROUNDING * t
            solved = gg * t * t <= LOOSENESS * LOOSENESS * moved
            if inner > 0 and (solved or gg <= noise * noise or inner >= PATIENCE):
                break
            # Newton step
            rows = 0
            for c in range(count):
                i = active[c]
                for b in range(6):
                    argument[b] = M[b, i] + sigma * N[b, i]
                rows = jacobian_rows(argument, t, sigma, atoms[i], F, rows)
            if robust:
                for a in range(2):
                    for m in range(seen):
                        j = visible[m]
                        curvature[a, m] = rho[j] if fresh_E[a, j] != 0.0 else 0.0
            shift = delta
            if delta == 0.0:
                shift = sigma * (1e-13 + 1e-7 * min(1.0, np.sqrt(gg)))
            newton_direction(F, rows, curvature, h, shift, delta > 0.0, g, H, small, d)
            direction = d.reshape(2, q)
            correlate(direction, planes, dN)
            if robust:
                expand_rows(direction, visible, h, seen, D)
            slope, yd, dd, wd = 0.0, 0.0, 0.0, 0.0
            for a in range(2):
                for j in range(q):
                    slope += g[a * q + j] * d[a * q + j]
                    yd += y[a, j] * d[a * q + j]
                    wd += W[a, j] * d[a * q + j]
                    dd += d[a * q + j] ** 2
            step = 1.0
            while True:
                trial = delta * (0.5 * yy + step * yd + 0.5 * step * step * dd) - yw - step * wd
                trial += moreau(M, N, step, dN, sigma, t, total) / (2.0 * sigma)
                if robust:
                    trial += 0.5 * soft_squared(E, Y, step, D, rho, threshold)
                enough = phi + ARMIJO * step * slope + 1e-13 * abs(phi)
                if trial <= enough or step < SHORTEST:
                    break
                step *= 0.5
            phi = trial
            steps += 1
            inner += 1
            yy, yw = 0.0, 0.0
            for a in range(2):
                for j in range(q):
                    y[a, j] += step * d[a * q + j]
                    yy += y[a, j] ** 2
                    yw += y[a, j] * W[a, j]
            for b in range(6):
                Nb, dNb = N[b], dN[b]
                for i in range(k):
                    Nb[i] += step * dNb[i]
            if robust:
                for a in range(2):
                    for j in range(p):
                        Y[a, j] += step * D[a, j]
        M[:] = 0.0
        for c in range(count):
            for b in range(6):
                M[b, active[c]] = fresh[c, b]
        if robust:
            E[:] = fresh_E
        if gap <= tolerance or steps >= most or not gap < np.inf:
            return steps
        sigma = sigma * GROWTH if solved else sigma / GROWTH
