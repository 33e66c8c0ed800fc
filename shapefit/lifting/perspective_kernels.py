"""Levenberg-Marquardt steps for one shape under a full perspective projection.

With X = R S + t and S = sum_i c_i B_i, a step is taken in the six parameters of the pose,
X <- X + omega x (R S) + tau, and in the coefficients, kept >= 0. Cauchy's loss is majorised by a
weighted square at the present residuals; the pose is eliminated from the normal equations, and
what is left is a small convex quadratic program in c.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from shapefit.convex.kernel import kernel
from shapefit.lifting.scaled_coefficients_kernel import scaled_coefficients

Floats = NDArray[np.float64]

POSE = 6
FIRST_DAMPING, LEAST_DAMPING, MOST_DAMPING = 1e-3, 1e-9, 1e8
EASE, HARDEN = 0.2, 5.0  # factors of the damping after a step that was kept, and one that was not
SETTLED = 1e-10  # relative fall of the objective at which the last softness is done,
FLEETING = 1e-2  # and at which the softer ones before it are
CONVERGED, LIMIT, DEGENERATE, FAILED = 0, 1, 2, 3


@kernel
def perspective_stretch(
    W: Floats, weights: Floats, atoms: Floats, prior: Floats, focal: Floats, centre: Floats,
    sign: float, ridge: float, softness: float, max_rounds: int, R: Floats, t: Floats, c: Floats,
    objective: Floats, rounds: NDArray[np.int64], codes: NDArray[np.int64],
) -> None:  # fmt: skip
    """Refine each image of a stretch, as `refine_perspective` says.

    R (n, 3, 3), t (n, 3), c (n, k) hold the start and are overwritten.
    """
    for image in range(len(W)):
        seen = np.flatnonzero(weights[image] > 0)
        objective[image], rounds[image], codes[image] = refine_image(
            W[image][:, seen], weights[image][seen], np.ascontiguousarray(atoms[:, :, seen]), prior,
            focal[image], centre[image], sign, ridge, softness, max_rounds,
            R[image], t[image], c[image],
        )  # fmt: skip


@kernel
def refine_image(
    w: Floats, omega: Floats, B: Floats, prior: Floats, focal: Floats, centre: Floats,
    sign: float, ridge: float, softness: float, max_rounds: int, R: Floats, t: Floats, c: Floats,
) -> tuple[float, int, int]:  # fmt: skip
    """Refine one image with all landmarks seen; returns objective, rounds and code.

    w (2, q), omega (q,), B (k, 3, q). The softness halves from 1 to its last value, so that many
    landmarks pull while the pose is still coarse. DEGENERATE where a landmark begins behind the
    camera: no step is taken from there.
    """
    k, q = len(c), w.shape[1]
    turned, X, r = np.empty((3, q)), np.empty((3, q)), np.empty((2, q))
    J, H, g = np.empty((2 * q, POSE + k + 1)), np.empty((POSE + k, POSE + k)), np.empty(POSE + k)
    gauge = prior / (prior @ prior)
    trial_R, trial_t, trial_c = np.empty((3, 3)), np.empty(3), np.empty(k)
    soft, damping, count = max(1.0, softness), FIRST_DAMPING, 0
    project(w, omega, B, focal, centre, sign, R, t, c, turned, X, r)
    F = evaluate(r, soft, c, prior, ridge)
    if not np.inf > F:  # nan too; a kernel folds isfinite away
        return np.nan, 0, DEGENERATE if np.any(r == np.inf) else FAILED
    while count < max_rounds:
        count += 1
        linearise(omega, B, focal, sign, R, turned, X, r, soft, J)
        fall = 0.0
        while damping <= MOST_DAMPING:
            find_step(J, ridge, prior, gauge, c, damping, H, g)
            move(R, t, c, g, trial_R, trial_t, trial_c)
            project(w, omega, B, focal, centre, sign, trial_R, trial_t, trial_c, turned, X, r)
            trial = evaluate(r, soft, trial_c, prior, ridge)
            if trial < F:
                fall = (F - trial) / F
                F = trial
                R[:], t[:], c[:] = trial_R, trial_t, trial_c
                damping = max(damping * EASE, LEAST_DAMPING)
                break
            damping *= HARDEN
        if soft <= softness and fall <= SETTLED:
            return F, count, CONVERGED
        if soft > softness and fall <= FLEETING:
            soft, damping = max(0.5 * soft, softness), FIRST_DAMPING
        project(w, omega, B, focal, centre, sign, R, t, c, turned, X, r)
        F = evaluate(r, soft, c, prior, ridge)
    return evaluate(r, softness, c, prior, ridge), count, LIMIT


@kernel
def project(
    w: Floats, omega: Floats, B: Floats, focal: Floats, centre: Floats, sign: float,
    R: Floats, t: Floats, c: Floats, turned: Floats, X: Floats, r: Floats,
) -> None:  # fmt: skip
    """Write R S, X = R S + t and r = omega (centre + focal X_xy / (sign X_z) - w), all (., q).

    r is infinite where a landmark is not in front of the camera.
    """
    k, _, q = B.shape
    turned[:] = 0.0
    for i in range(k):
        if c[i] != 0.0:
            for j in range(q):
                x, y, z = B[i, 0, j], B[i, 1, j], B[i, 2, j]
                for a in range(3):
                    turned[a, j] += c[i] * (R[a, 0] * x + R[a, 1] * y + R[a, 2] * z)
    for j in range(q):
        for a in range(3):
            X[a, j] = turned[a, j] + t[a]
        depth = sign * X[2, j]
        for a in range(2):
            seen = centre[a] + focal[a] * X[a, j] / depth
            r[a, j] = omega[j] * (seen - w[a, j]) if depth > 0 else np.inf


@kernel
def evaluate(r: Floats, soft: float, c: Floats, prior: Floats, ridge: float) -> float:
    """F = 1/2 sum_j s^2 log(1 + |r_j|^2 / s^2) + ridge/2 |c - prior|^2."""
    F = 0.0
    for j in range(r.shape[1]):
        F += soft**2 * np.log1p((r[0, j] ** 2 + r[1, j] ** 2) / soft**2)
    for i in range(len(c)):
        F += ridge * (c[i] - prior[i]) ** 2
    return 0.5 * F


@kernel
def linearise(
    omega: Floats, B: Floats, focal: Floats, sign: float, R: Floats, turned: Floats, X: Floats,
    r: Floats, soft: float, J: Floats,
) -> None:  # fmt: skip
    """Write the Jacobian of r in (omega, tau, c), and r in the last column, times sqrt(weight).

    J (2 q, 6 + k + 1). The weight 1 / (1 + |r_j|^2 / s^2) is that of the square that touches
    Cauchy's loss from above at r_j.
    """
    k, _, q = B.shape
    v, u = np.empty(3), np.empty(3)
    for j in range(q):
        root = 1.0 / np.sqrt(1.0 + (r[0, j] ** 2 + r[1, j] ** 2) / soft**2)
        depth = sign * X[2, j]
        for a in range(2):
            row = J[2 * j + a]
            along = root * omega[j] * focal[a] / depth
            v[:] = 0.0  # the derivative in X_j
            v[a], v[2] = along, -along * X[a, j] / X[2, j]
            row[0] = turned[1, j] * v[2] - turned[2, j] * v[1]
            row[1] = turned[2, j] * v[0] - turned[0, j] * v[2]
            row[2] = turned[0, j] * v[1] - turned[1, j] * v[0]
            row[3:6] = v
            for b in range(3):
                u[b] = v[0] * R[0, b] + v[1] * R[1, b] + v[2] * R[2, b]
            for i in range(k):
                row[6 + i] = u[0] * B[i, 0, j] + u[1] * B[i, 1, j] + u[2] * B[i, 2, j]
            row[6 + k] = root * r[a, j]


@kernel
def find_step(
    J: Floats, ridge: float, prior: Floats, gauge: Floats, c: Floats, damping: float, H: Floats,
    g: Floats,
) -> None:  # fmt: skip
    """Write the damped step to g (6 + k,): argmin 1/2 |J d + r|^2 + ridge/2 |c + d_c - prior|^2.

    Over d_c >= -c with gauge^T d_c = 0, and with damping / 2 times the squared step, scaled by the
    diagonal of J^T J. The pose is eliminated first; H (6 + k, 6 + k) is workspace.
    """
    rows, size = J.shape[0], len(g)
    H[:], g[:] = 0.0, 0.0
    for row in range(rows):
        Jr = J[row]
        residual = Jr[size]
        for i in range(size):
            value = Jr[i]
            g[i] -= value * residual
            Hi = H[i]
            for j in range(i, size):
                Hi[j] += value * Jr[j]
    for i in range(size):
        H[i, i] *= 1.0 + damping
        if i >= POSE:
            H[i, i] += ridge
            g[i] += ridge * (prior[i - POSE] - c[i - POSE])
    for e in range(POSE):
        He = H[e]
        pivot = 1.0 / np.sqrt(max(He[e], 1e-300))
        g[e] *= pivot
        for j in range(e, size):
            He[j] *= pivot
        for i in range(e + 1, size):
            factor, Hi = He[i], H[i]
            g[i] -= factor * g[e]
            for j in range(i, size):
                Hi[j] -= factor * He[j]
    Q = H[POSE:, POSE:]
    x, h = c.copy(), g[POSE:].copy()
    for i in range(len(c)):  # the quadratic in c + d_c
        for j in range(len(c)):
            h[i] += (Q[i, j] if i < j else Q[j, i]) * c[j]
    scaled_coefficients(Q, h, gauge, x)
    g[POSE:] = x - c
    for e in range(POSE - 1, -1, -1):
        value = g[e]
        for j in range(e + 1, size):
            value -= H[e, j] * g[j]
        g[e] = value / H[e, e]


@kernel
def move(
    R: Floats, t: Floats, c: Floats, step: Floats, new_R: Floats, new_t: Floats, new_c: Floats
) -> None:
    """exp([omega]_x) R, t + tau and c + d_c, with omega, tau, d_c in step (6 + k,)."""
    angle = np.sqrt(step[0] ** 2 + step[1] ** 2 + step[2] ** 2)
    sine = np.sin(angle) / angle if angle > 1e-8 else 1.0
    rest = (1.0 - np.cos(angle)) / angle**2 if angle > 1e-4 else 0.5
    for b in range(3):
        x, y, z = R[0, b], R[1, b], R[2, b]
        along = step[0] * x + step[1] * y + step[2] * z
        cosine = 1.0 - rest * angle**2
        new_R[0, b] = cosine * x + sine * (step[1] * z - step[2] * y) + rest * along * step[0]
        new_R[1, b] = cosine * y + sine * (step[2] * x - step[0] * z) + rest * along * step[1]
        new_R[2, b] = cosine * z + sine * (step[0] * y - step[1] * x) + rest * along * step[2]
    for a in range(3):
        new_t[a] = t[a] + step[3 + a]
    for i in range(len(c)):
        new_c[i] = c[i] + step[POSE + i]
