"""The loop over a stretch of images: reduce, start, solve, certify."""

from __future__ import annotations

import numpy as np

from shapefit.convex.block_kernels import correlate, largest_nuclear_norm
from shapefit.convex.certificate_kernel import certify
from shapefit.convex.kernel import kernel
from shapefit.convex.newton_kernels import solve_reduced
from shapefit.convex.reduction_kernels import expand_rows, find_visible, reduce_rows


@kernel
def solve_stretch(
    W, Omega, B, lam, delta, bound, tolerance, most,
    M_out, T_out, Y_out, E_out, objective, gaps, residuals, steps, status,
):  # fmt: skip
    """Solve images (n, 2, p) in turn, each from its neighbour's solution where that explains it.

    Inputs are those of Problem; everything after `most` is written. Status codes: 0 optimal,
    1 iteration limit, 2 degenerate, 3 numerical failure.
    """
    n, k, p = W.shape[0], B.shape[0], B.shape[2]
    padded = (k + 7) // 8 * 8  # zero atoms fill the last vector; they never become active
    M, N = np.zeros((6, padded)), np.zeros((6, padded))
    visible, h, last = np.zeros(p, np.int64), np.zeros(p), np.full(p, -1.0)
    Y = np.zeros((2, p))
    seen, have_start = 0, False
    planes, atoms, w, y = np.zeros((3, 0, padded)), np.zeros((padded, 3, 0)), W[0], W[0]
    for image in range(n):
        omega = Omega[image]
        E = E_out[image]
        changed = False
        for j in range(p):
            changed |= omega[j] != last[j]
        if changed:
            seen = find_visible(omega, visible, h)
            last[:] = omega
            q = max(seen - 1, 0)
            planes, atoms = np.zeros((3, q, padded)), np.zeros((padded, 3, q))
            w, y = np.zeros((2, q)), np.zeros((2, q))
            if q > 0:
                for i in range(k):
                    reduce_rows(B[i], omega, visible, h, seen, atoms[i])
                    for b in range(3):
                        for j in range(q):
                            planes[b, j, i] = atoms[i, b, j]
        if seen < 2:
            status[image] = 2
            objective[image] = np.nan
            gaps[image] = np.nan
            residuals[image] = np.nan
            continue
        reduce_rows(W[image], omega, visible, h, seen, w)
        # Start from the neighbour where its transforms explain this image, else from zero.
        warm = False
        if have_start:
            left, all_of_it = 0.0, 0.0
            for a in range(2):
                for j in range(seen - 1):
                    r = w[a, j]
                    all_of_it += r * r
                    for i in range(k):
                        if M[3 * a, i] != 0.0 or M[3 * a + 1, i] != 0.0:
                            r -= (
                                M[3 * a, i] * atoms[i, 0, j]
                                + M[3 * a + 1, i] * atoms[i, 1, j]
                                + M[3 * a + 2, i] * atoms[i, 2, j]
                            )
                    left += r * r
            warm = left < 0.1 * all_of_it
        if warm:
            ones = np.ones(p)
            reduce_rows(Y, ones, visible, h, seen, y)
        else:
            M[:] = 0.0
            correlate(w, planes, N)
            y[:] = w * min(1.0, lam[image] / max(largest_nuclear_norm(N), 1e-300))
            E[:] = 0.0
        steps[image] = solve_reduced(
            w, planes, atoms, lam[image], delta, bound, visible, h, tolerance, most, M, E, y
        )
        expand_rows(y, visible, h, seen, Y)
        out = M_out[image]
        for i in range(k):
            for a in range(2):
                for b in range(3):
                    out[i, a, b] = M[3 * a + b, i]
        Y_out[image] = Y
        objective[image], gaps[image], residuals[image] = certify(
            W[image], omega, B, lam[image], delta, bound, out, E, Y_out[image], T_out[image]
        )
        if not np.isfinite(gaps[image]):
            status[image] = 3
            have_start = False
            continue
        have_start = True
        judged = abs(gaps[image])
        if delta == 0.0 and not np.isfinite(bound):
            judged = max(judged, residuals[image])
        status[image] = 0 if judged <= tolerance else 1
        for a in range(2):
            for j in range(seen):
                if np.isfinite(bound):
                    E[a, visible[j]] /= omega[visible[j]]
