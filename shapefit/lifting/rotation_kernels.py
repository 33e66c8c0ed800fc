"""The rotation step: a Riemannian trust region on the two orthonormal rows of a rotation.

min 1/2 ||w - s Rbar S||_F^2 over Rbar Rbar^T = I_2 depends on w (2, q) and S (3, q) only through
P = S S^T and D = w S^T. Rbar lies on the Stiefel manifold with the Euclidean metric; (r3; 0),
(0; r3) and (-r2; r1) / sqrt(2) are an orthonormal basis of its tangent space, where r3 = r1 x r2,
so that gradient, Hessian and steps are 3-vectors and 3x3 matrices in closed form.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from shapefit.convex.kernel import kernel

Floats = NDArray[np.float64]

HALF = np.sqrt(0.5)
# The rules of Absil, Baker and Gallivan 2007, with the constants of Manopt.
LARGEST_RADIUS = np.sqrt(2.0)
FIRST_RADIUS = LARGEST_RADIUS / 8
ACCEPT, SHRINK, GROW = 0.1, 0.25, 0.75
LINEAR = 0.1  # tCG stops where the residual is |g| min(|g|, LINEAR)
# Beside the size of the terms of value and gradient, s (s tr P + ||D||):
ROUNDING = 1e3 * 2.0**-52  # changes of the value below this are not judged
STATIONARY = 1e-11  # norm of the gradient at the end
MOST_STEPS = 200


@kernel
def rotation_step(P: Floats, D: Floats, free: bool, R: Floats) -> tuple[float, float]:
    """Take R to a local minimum; returns 1/2 ||w - s Rbar S||^2 - 1/2 ||w||^2 there, and s.

    P (3, 3), D (2, 3), R (3, 3) proper, overwritten. s is 1, or the best scale >= 0 where `free`.
    """
    g, H, step, trial = np.empty(3), np.empty((3, 3)), np.empty(3), np.empty((3, 3))
    trace, norm = P[0, 0] + P[1, 1] + P[2, 2], 0.0
    for a in range(2):
        norm += D[a, 0] ** 2 + D[a, 1] ** 2 + D[a, 2] ** 2
    norm = np.sqrt(norm)
    radius = FIRST_RADIUS
    value, s = model_at(P, D, free, R, g, H)
    for _ in range(MOST_STEPS):
        size = s * (s * trace + norm)
        if np.sqrt(g[0] ** 2 + g[1] ** 2 + g[2] ** 2) <= STATIONARY * size:
            break
        at_edge, promised = truncated_cg(g, H, radius, step)
        retract(R, step, trial)
        reached = value_at(P, D, free, trial)
        slack = ROUNDING * size
        ratio = (value - reached + slack) / (promised + slack)
        if not ratio >= SHRINK:
            radius *= 0.25
        elif ratio > GROW and at_edge:
            radius = min(2.0 * radius, LARGEST_RADIUS)
        if ratio > ACCEPT:
            R[:] = trial
            value, s = model_at(P, D, free, R, g, H)
    return value, s


@kernel
def value_at(P: Floats, D: Floats, free: bool, R: Floats) -> float:
    """1/2 s^2 <Rbar P, Rbar> - s <D, Rbar>."""
    a, b = 0.0, 0.0
    for i in range(2):
        for j in range(3):
            a += D[i, j] * R[i, j]
            b += R[i, j] * (P[j, 0] * R[i, 0] + P[j, 1] * R[i, 1] + P[j, 2] * R[i, 2])
    if free:
        return -0.5 * max(a, 0.0) ** 2 / b if b > 0.0 else 0.0
    return 0.5 * b - a


@kernel
def model_at(
    P: Floats, D: Floats, free: bool, R: Floats, g: Floats, H: Floats
) -> tuple[float, float]:
    """Value and s at R; writes the Riemannian gradient g (3,) and Hessian H (3, 3).

    The Hessian is Proj(s^2 U P - Lambda U) with Lambda = sym(Rbar G^T) and G = s (s Rbar P - D);
    a free s takes its share off, h h^T / tr(Rbar P Rbar^T) with h the derivative of the gradient
    by s (Schur complement).
    """
    PR = np.empty((3, 3))  # P in the frame of R: r_a P r_b
    DR = np.empty((2, 3))  # D in the frame of R: D_a r_b
    for b in range(3):
        x = P[0, 0] * R[b, 0] + P[0, 1] * R[b, 1] + P[0, 2] * R[b, 2]
        y = P[1, 0] * R[b, 0] + P[1, 1] * R[b, 1] + P[1, 2] * R[b, 2]
        z = P[2, 0] * R[b, 0] + P[2, 1] * R[b, 1] + P[2, 2] * R[b, 2]
        for a in range(3):
            PR[a, b] = R[a, 0] * x + R[a, 1] * y + R[a, 2] * z
        for a in range(2):
            DR[a, b] = D[a, 0] * R[b, 0] + D[a, 1] * R[b, 1] + D[a, 2] * R[b, 2]
    overlap, square = DR[0, 0] + DR[1, 1], PR[0, 0] + PR[1, 1]
    s = 1.0
    if free:
        s = max(overlap, 0.0) / square if square > 0.0 else 0.0
    turn = HALF * (DR[0, 1] - DR[1, 0])
    g[0] = s * (s * PR[0, 2] - DR[0, 2])
    g[1] = s * (s * PR[1, 2] - DR[1, 2])
    g[2] = s * turn
    H[0, 0] = s * (s * (PR[2, 2] - PR[0, 0]) + DR[0, 0])
    H[1, 1] = s * (s * (PR[2, 2] - PR[1, 1]) + DR[1, 1])
    H[2, 2] = 0.5 * s * overlap
    H[0, 1] = s * (0.5 * (DR[0, 1] + DR[1, 0]) - s * PR[0, 1])
    H[0, 2] = -s * s * HALF * PR[1, 2]
    H[1, 2] = s * s * HALF * PR[0, 2]
    H[1, 0], H[2, 0], H[2, 1] = H[0, 1], H[0, 2], H[1, 2]
    if free and s > 0.0:
        h0, h1, h2 = 2.0 * s * PR[0, 2] - DR[0, 2], 2.0 * s * PR[1, 2] - DR[1, 2], turn
        H[0, 0] -= h0 * h0 / square
        H[1, 1] -= h1 * h1 / square
        H[2, 2] -= h2 * h2 / square
        H[0, 1] -= h0 * h1 / square
        H[0, 2] -= h0 * h2 / square
        H[1, 2] -= h1 * h2 / square
        H[1, 0], H[2, 0], H[2, 1] = H[0, 1], H[0, 2], H[1, 2]
    return 0.5 * s * s * square - s * overlap, s


@kernel
def truncated_cg(g: Floats, H: Floats, radius: float, step: Floats) -> tuple[bool, float]:
    """Steihaug's conjugate gradients for min g x + 1/2 x H x over |x| <= radius; step (3,).

    Returns whether the step ends at the edge, and the fall of the model that it promises.
    """
    r, d, Hd = np.empty(3), np.empty(3), np.empty(3)
    rr = 0.0
    for a in range(3):
        step[a] = 0.0
        r[a] = g[a]
        d[a] = -g[a]
        rr += g[a] * g[a]
    goal = np.sqrt(rr) * min(np.sqrt(rr), LINEAR)
    xx, xd, dd, fall, at_edge = 0.0, 0.0, rr, 0.0, False
    for _ in range(3):
        curvature, slope = 0.0, 0.0
        for a in range(3):
            Hd[a] = H[a, 0] * d[0] + H[a, 1] * d[1] + H[a, 2] * d[2]
            curvature += d[a] * Hd[a]
            slope += d[a] * r[a]
        length = rr / curvature if curvature > 0.0 else 0.0
        at_edge = curvature <= 0.0 or xx + length * (2.0 * xd + length * dd) >= radius * radius
        if at_edge:
            length = (np.sqrt(xd * xd + dd * (radius * radius - xx)) - xd) / dd
        before = rr
        rr = 0.0
        for a in range(3):
            step[a] += length * d[a]
            r[a] += length * Hd[a]
            rr += r[a] * r[a]
        fall -= length * (slope + 0.5 * length * curvature)
        if at_edge or np.sqrt(rr) <= goal:
            break
        ratio = rr / before
        xx += length * (2.0 * xd + length * dd)
        xd = ratio * (xd + length * dd)
        dd = rr + ratio * ratio * dd
        for a in range(3):
            d[a] = ratio * d[a] - r[a]
    return at_edge, fall


@kernel
def retract(R: Floats, step: Floats, out: Floats) -> None:
    """Orthonormalise Rbar + step, step (3,) in the basis of the tangent space, and complete it."""
    turn = HALF * step[2]
    for b in range(3):
        out[0, b] = R[0, b] + step[0] * R[2, b] - turn * R[1, b]
        out[1, b] = R[1, b] + step[1] * R[2, b] + turn * R[0, b]
    complete(out)


@kernel
def complete(R: Floats) -> None:
    """Orthonormalise the first two rows by Gram-Schmidt; their cross product is the third."""
    xx, yx, yy = 0.0, 0.0, 0.0
    for b in range(3):
        xx += R[0, b] * R[0, b]
        yx += R[1, b] * R[0, b]
    for b in range(3):
        R[1, b] -= yx / xx * R[0, b]
        yy += R[1, b] * R[1, b]
    for b in range(3):
        R[0, b] /= np.sqrt(xx)
        R[1, b] /= np.sqrt(yy)
    for b in range(3):
        i, j = (b + 1) % 3, (b + 2) % 3
        R[2, b] = R[0, i] * R[1, j] - R[0, j] * R[1, i]
