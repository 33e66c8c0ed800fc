"""The loop over a stretch of images: reduce, start, solve, certify."""

from __future__ import annotations

import numpy as np

from shapefit.convex.block_kernels import correlate, largest_nuclear_norm
from shapefit.convex.certificate_kernel import certify
from shapefit.convex.kernel import kernel
from shapefit.convex.newton_kernels import solve_reduced
from shapefit.convex.reduction_kernels import expand_rows, find_visible, reduce_rows

# The solver aims a little below the tolerance, so that the certificate in the units of the data,
# which rounds differently, agrees with it.
CLOSER = 0.99


@kernel
def _write_scaled_atoms(B, omega, visible, h, seen, planes, atoms):
    """Write the reduced atoms with the largest norm scaled to 1; returns that norm, 1 if zero.

    B (k, 3, p); planes (3, seen - 1, >= k) and atoms (>= k, 3, seen - 1), zero beyond k.
    """
    largest = 0.0
    for i in range(B.shape[0]):
        reduce_rows(B[i], omega, visible, h, seen, atoms[i])
        square = 0.0
        for b in range(3):
            for j in range(seen - 1):
                square += atoms[i, b, j] ** 2
        largest = max(largest, square)
    largest = np.sqrt(largest) if largest > 0.0 else 1.0
    for i in range(B.shape[0]):
        for b in range(3):
            for j in range(seen - 1):
                atoms[i, b, j] /= largest
                planes[b, j, i] = atoms[i, b, j]
    return largest


@kernel
def _explains(M, atoms, w):
    """Whether ||w - sum M_i B_i||^2 < ||w||^2 / 10; M (6, k), atoms (k, 3, q), w (2, q)."""
    left, whole = 0.0, 0.0
    for a in range(2):
        for j in range(w.shape[1]):
            r = w[a, j]
            whole += r * r
            for i in range(atoms.shape[0]):
                if M[3 * a, i] != 0.0 or M[3 * a + 1, i] != 0.0:
                    r -= (
                        M[3 * a, i] * atoms[i, 0, j]
                        + M[3 * a + 1, i] * atoms[i, 1, j]
                        + M[3 * a + 2, i] * atoms[i, 2, j]
                    )
            left += r * r
    return left < 0.1 * whole


@kernel
def solve_stretch(
    W, Omega, B, lam, delta, bound, tolerance, most, started,
    M_out, T_out, Y_out, E_out, objective, gaps, residuals, steps, status,
):  # fmt: skip
    """Solve images (n, 2, p) in turn, each from its neighbour's solution where that explains it.

    Inputs are those of Problem; everything after `started` is written. Where `started`, M_out,
    Y_out and E_out hold a start for each image, which takes the place of the neighbour's. Status
    codes: 0 optimal, 1 iteration limit, 2 degenerate, 3 numerical failure.

    Every image is solved in the units ||w|| = 1 and max ||B_i|| = 1, and lambda = 1 where the loss
    has no quadratic, so that the unit of the dual is free. There the weights move from the
    residual to the bounds of the dual, f(omega r) = omega f(r): the same program, but well
    conditioned whatever the weights.
    """
    n, k, p = W.shape[0], B.shape[0], B.shape[2]
    padded = (k + 7) // 8 * 8  # zero atoms fill the last vector; they never become active
    robust = bound < np.inf
    M, N = np.zeros((6, padded)), np.zeros((6, padded))
    visible, h, last = np.zeros(p, np.int64), np.zeros(p), np.full(p, -1.0)
    rho, ones, bounds = np.ones(p), np.ones(p), np.ones(p)
    Y, V = np.zeros((2, p)), np.zeros((2, p))
    seen, have_start, size, largest = 0, False, 1.0, 1.0
    planes, atoms, w, y = np.zeros((3, 0, padded)), np.zeros((padded, 3, 0)), W[0], W[0]
    for image in range(n):
        omega, E, out = Omega[image], E_out[image], M_out[image]
        old_size, old_largest = size, largest
        changed = False
        for j in range(p):
            changed |= omega[j] != last[j]
        if changed:
            for j in range(p):
                last[j] = omega[j]
                rho[j] = 1.0 if delta == 0.0 and omega[j] > 0.0 else omega[j]
            seen = find_visible(rho, visible, h)
            q = max(seen - 1, 0)
            planes, atoms = np.zeros((3, q, padded)), np.zeros((padded, 3, q))
            w, y = np.zeros((2, q)), np.zeros((2, q))
            if q > 0:
                largest = _write_scaled_atoms(B, rho, visible, h, seen, planes, atoms)
        if seen < 2:
            status[image] = 2
            objective[image] = np.nan
            gaps[image] = np.nan
            residuals[image] = np.nan
            continue
        for m in range(seen):
            for a in range(2):  # from the first landmark, so that one point is exactly zero
                V[a, visible[m]] = W[image, a, visible[m]] - W[image, a, visible[0]]
        reduce_rows(V, rho, visible, h, seen, w)
        square = 0.0
        for j in range(seen - 1):
            square += w[0, j] ** 2 + w[1, j] ** 2
        size = np.sqrt(square) if square > 0.0 else 1.0
        w /= size
        unit = size if delta > 0.0 else lam[image] / largest  # of the dual
        scaled_lam = lam[image] / (unit * largest)
        for j in range(p):
            bounds[j] = (bound if delta > 0.0 else bound * omega[j]) / unit
        if started:
            for i in range(k):
                for a in range(2):
                    for b in range(3):
                        M[3 * a + b, i] = out[i, a, b] * (largest / size)
            for m in range(seen):
                j = visible[m]
                for a in range(2):
                    Y[a, j] = Y_out[image, a, j] * (omega[j] / rho[j])
                    E[a, j] *= rho[j] / size
            have_start = np.sum(np.abs(M)) + np.sum(np.abs(Y)) + np.sum(np.abs(E)) < np.inf
        elif have_start:
            M *= (old_size / size) * (largest / old_largest)
            have_start = _explains(M, atoms, w)
        if have_start:
            reduce_rows(Y, ones, visible, h, seen, y)
            y /= unit
        else:
            M[:] = 0.0
            E[:] = 0.0
            correlate(w, planes, N)
            y[:] = w * min(1.0, scaled_lam / max(largest_nuclear_norm(N), 1e-300))
        steps[image] = solve_reduced(
            w, planes, atoms, scaled_lam, delta, robust, bounds, visible, h, CLOSER * tolerance,
            most, M, E, y,
        )  # fmt: skip
        y *= unit
        expand_rows(y, visible, h, seen, Y)
        for i in range(k):
            for a in range(2):
                for b in range(3):
                    out[i, a, b] = M[3 * a + b, i] * (size / largest)
        for m in range(seen):
            j = visible[m]
            for a in range(2):
                Y_out[image, a, j] = Y[a, j] * (rho[j] / omega[j])
                E[a, j] *= size * (omega[j] / rho[j])
        objective[image], gaps[image], residuals[image] = certify(
            W[image], omega, B, lam[image], delta, bound, out, E, Y_out[image], T_out[image]
        )
        have_start = abs(gaps[image]) < np.inf
        if not have_start:
            status[image] = 3
            continue
        judged = abs(gaps[image])
        if delta == 0.0 and not robust:
            judged = max(judged, residuals[image])
        status[image] = 0 if judged <= tolerance else 1
        if robust:
            for m in range(seen):
                j = visible[m]
                for a in range(2):
                    E[a, j] /= omega[j]
