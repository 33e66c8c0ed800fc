"""The certificate from scratch: original data in, objective and gap out."""

from __future__ import annotations

import numpy as np

from shapefit.convex.kernel import kernel


@kernel
def certify(W, omega, B, lam, delta, bound, M, E, Y, T):
    """Objective, relative duality gap and relative residual; T (2,) and E (2, p) are written.

    W (2, p), omega (p,), B (k, 3, p), M (k, 2, 3), Y (2, p). On entry E holds the sparse errors
    from which the translation follows: the mean of what M and E leave, weighted by omega^2 where
    the loss has a quadratic. On return it holds those that minimise the objective. Y is made
    orthogonal to omega and scaled until it is dual feasible, so P - D bounds the distance to the
    optimum whatever the solver did.
    """
    k, p = B.shape[0], B.shape[2]
    V, R = np.zeros((2, p)), np.zeros((2, p))  # V: W centred, R: what M leaves of it
    mean = np.zeros(2)
    square, scale = 0.0, 0.0
    first = 0
    for j in range(p):
        square += omega[j] ** 2
        if omega[p - 1 - j] > 0.0:
            first = p - 1 - j
    for a in range(2):
        anchor = W[a, first]  # taken off first: landmarks on one point are exactly zero
        for j in range(p):
            if omega[j] > 0.0:
                mean[a] += omega[j] ** 2 * (W[a, j] - anchor) / square
        for j in range(p):
            if omega[j] > 0.0:
                V[a, j] = W[a, j] - anchor - mean[a]
                R[a, j] = V[a, j]
        mean[a] += anchor
    norms = 0.0
    for i in range(k):
        m = M[i]
        A = m[0, 0] * m[0, 0] + m[0, 1] * m[0, 1] + m[0, 2] * m[0, 2]
        C = m[1, 0] * m[1, 0] + m[1, 1] * m[1, 1] + m[1, 2] * m[1, 2]
        D = m[0, 0] * m[1, 0] + m[0, 1] * m[1, 1] + m[0, 2] * m[1, 2]
        if A + C == 0.0:
            continue
        for a in range(2):
            for j in range(p):
                R[a, j] -= m[a, 0] * B[i, 0, j] + m[a, 1] * B[i, 1, j] + m[a, 2] * B[i, 2, j]
        # largest eigenvalue of M M^T, exact where the two are equal
        norms += np.sqrt(0.5 * (A + C + np.hypot(A - C, 2.0 * D)))

    robust = bound < np.inf
    primal, residual = lam * norms, 0.0
    for a in range(2):
        shift, weights = 0.0, 0.0
        for j in range(p):
            if omega[j] > 0.0:
                weight = omega[j] ** 2 if delta > 0.0 else 1.0
                shift += weight * (R[a, j] - E[a, j] / omega[j])
                weights += weight
        shift /= weights
        T[a] = mean[a] + shift
        along = 0.0
        for j in range(p):
            r = omega[j] * (R[a, j] - shift)
            residual += r * r
            scale += (omega[j] * V[a, j]) ** 2
            if robust:
                size = abs(r)
                if delta > 0.0:
                    E[a, j] = np.sign(r) * max(size - bound, 0.0)
                    primal += 0.5 * r * r if size <= bound else bound * (size - 0.5 * bound)
                else:
                    E[a, j] = r
                    primal += bound * size
            elif delta > 0.0:
                primal += 0.5 * r * r
            along += Y[a, j] * omega[j] / square
        for j in range(p):
            Y[a, j] = Y[a, j] - along * omega[j] if omega[j] > 0.0 else 0.0

    yy, yw, largest, entry = 0.0, 0.0, 0.0, 0.0
    for j in range(p):
        for a in range(2):
            yy += Y[a, j] ** 2
            yw += Y[a, j] * omega[j] * V[a, j]
            entry = max(entry, abs(Y[a, j]))
    for i in range(k):
        x0, x1, x2, y0, y1, y2 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        B0, B1, B2 = B[i, 0], B[i, 1], B[i, 2]
        for j in range(p):
            u, v = Y[0, j] * omega[j], Y[1, j] * omega[j]
            x0 += u * B0[j]
            x1 += u * B1[j]
            x2 += u * B2[j]
            y0 += v * B0[j]
            y1 += v * B1[j]
            y2 += v * B2[j]
        c0, c1, c2 = x1 * y2 - x2 * y1, x2 * y0 - x0 * y2, x0 * y1 - x1 * y0
        trace = x0 * x0 + x1 * x1 + x2 * x2 + y0 * y0 + y1 * y1 + y2 * y2
        largest = max(largest, trace + 2.0 * np.sqrt(c0 * c0 + c1 * c1 + c2 * c2))
    feasible = lam / max(np.sqrt(largest), 1e-300)
    if robust:
        feasible = min(feasible, bound / max(entry, 1e-300))
    if delta > 0.0:
        feasible = min(feasible, yw / max(yy, 1e-300))
    feasible = max(feasible, 0.0)
    dual = feasible * yw - delta * 0.5 * feasible * feasible * yy
    for a in range(2):
        for j in range(p):
            Y[a, j] *= feasible
    gap = 0.0 if primal == 0.0 else (primal - dual) / primal
    return primal, gap, np.sqrt(residual / scale) if scale > 0.0 else 0.0


@kernel
def certify_all(W, Omega, B, lam, delta, bound, M, E, Y, T, objective, gaps, residuals):
    """Certify images (n, ...) one by one; E, Y and everything after are written."""
    for image in range(W.shape[0]):
        objective[image], gaps[image], residuals[image] = certify(
            W[image], Omega[image], B, lam[image], delta, bound, M[image], E[image], Y[image],
            T[image],
        )  # fmt: skip
