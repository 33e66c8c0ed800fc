"""Least squares on a sphere: the secular equation and its largest root."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from shapefit.convex.kernel import kernel

Floats = NDArray[np.float64]

ROUNDING = 64 * 2.0**-52
MOST_STEPS = 100


@kernel
def minimise_on_sphere(G: Floats, g: Floats, radius: float, y: Floats) -> float:
    """argmin y^T G y - 2 g^T y over ||y|| = radius, for symmetric G (m, m); g and y (m,).

    y is overwritten; of two minimisers it becomes the one nearer to what it was. Returns the
    multiplier: y minimises where (G + multiplier I) y = g and G + multiplier I is positive
    semidefinite, which is the largest root of the secular equation

        sum_i (t_i / (mu_i + multiplier))^2 = radius^2,      G = V diag(mu) V^T, t = V^T g.

    1 / ||y|| is a concave function of the multiplier right of the last pole: Newton's method from
    the left of the root never overshoots. Where g has no part along the least eigenvalue the
    pole may be none, and the root may lie left of it: then the multiplier is the pole and the
    eigenvector fills up y (the hard case). Source: Gander 1981; More and Sorensen 1983.
    """
    m = y.shape[0]
    mu, V = np.linalg.eigh(G)
    above, t, z, before = np.empty(m), np.zeros(m), np.zeros(m), 0.0
    square = 0.0
    for i in range(m):
        above[i] = mu[i] - mu[0]
        before += V[i, 0] * y[i]
        for j in range(m):
            t[i] += V[j, i] * g[j]
        square += t[i] ** 2
    size = np.sqrt(square) / radius + above[m - 1]  # of G + multiplier I
    shift = 0.0  # of the multiplier from the pole: on the left of the root or on it
    for i in range(m):
        if above[i] <= ROUNDING * size:
            above[i] = 0.0
            if abs(t[i]) <= ROUNDING * size * radius:
                t[i] = 0.0
        shift = max(shift, abs(t[i]) / radius - above[i])
    square = 0.0
    for _ in range(MOST_STEPS):
        square, slope = 0.0, 0.0
        for i in range(m):
            if t[i] != 0.0:
                z[i] = t[i] / (above[i] + shift)
                square += z[i] ** 2
                slope += z[i] ** 2 / (above[i] + shift)
        excess = np.sqrt(square) / radius - 1.0
        if excess <= ROUNDING:
            break
        shift += excess * square / slope
    if shift == 0.0:
        z[0] = np.copysign(np.sqrt(max(radius**2 - square, 0.0)), before)
        square += z[0] ** 2
    scale = radius / np.sqrt(square)
    for i in range(m):
        y[i] = 0.0
        for j in range(m):
            y[i] += scale * V[i, j] * z[j]
    return shift - mu[0]
