"""Norms of 2 x 3 blocks with rows x and y, from the invariants of x x^T + y y^T.

With g = ||x||^2 + ||y||^2 = s1^2 + s2^2 and v = ||x cross y|| = s1 s2 the nuclear norm is
s1 + s2 = sqrt(g + 2 v), and the spectral norm s1 is the root of the larger zero of
t^2 - g t + v^2, which is (g + h) / 2 with h = sqrt((||x||^2 - ||y||^2)^2 + 4 (x . y)^2). All sums
are of terms that are not negative, so that the norms are right to a few roundings.
"""

from __future__ import annotations

import numpy as np

from shapefit.arrays import Floats


def nuclear_norms(x: Floats, y: Floats) -> Floats:
    """Return s1 + s2 of the blocks with rows x and y, (..., 3, k) each: (..., k)."""
    x0, x1, x2 = (x[..., axis, :] for axis in range(3))
    y0, y1, y2 = (y[..., axis, :] for axis in range(3))
    across = (x1 * y2 - x2 * y1) ** 2 + (x2 * y0 - x0 * y2) ** 2 + (x0 * y1 - x1 * y0) ** 2
    square = x0 * x0 + x1 * x1 + x2 * x2 + y0 * y0 + y1 * y1 + y2 * y2
    norms: Floats = np.sqrt(square + 2 * np.sqrt(across))
    return norms


def spectral_norms(blocks: Floats) -> Floats:
    """Return s1 of blocks (a, 2, 3): (a,)."""
    x, y = blocks[:, 0], blocks[:, 1]
    xx, yy, xy = (np.einsum("ai,ai->a", *pair) for pair in ((x, x), (y, y), (x, y)))
    norms: Floats = np.sqrt((xx + yy + np.sqrt((xx - yy) ** 2 + 4 * xy**2)) / 2)
    return norms


def third_rows(blocks: Floats, norms: Floats) -> Floats:
    """(x cross y) / s1 of blocks (a, 2, 3), which completes them to s1 R: (a, 3); 0 for 0."""
    (x0, x1, x2), (y0, y1, y2) = blocks.transpose(1, 2, 0)
    across = np.stack([x1 * y2 - x2 * y1, x2 * y0 - x0 * y2, x0 * y1 - x1 * y0])
    thirds: Floats = np.divide(across, norms, out=np.zeros_like(across), where=norms > 0)
    return thirds.T


def polar_rows(blocks: Floats, norms: Floats) -> tuple[Floats, Floats]:
    """s1 (M M^T)^(-1/2) M of blocks M (a, 2, 3), and its condition s1 / s2 (a,), inf for rank 1.

    The nearest pair of orthonormal rows, times s1. A = M M^T and v = s1 s2 give
    A^(-1/2) = ((tr A + v) I - A) / (v (s1 + s2)).
    """
    across = np.cross(blocks[:, 0], blocks[:, 1])
    v = np.sqrt(np.einsum("ai,ai->a", across, across))
    A = blocks @ blocks.swapaxes(1, 2)
    trace = A[:, 0, 0] + A[:, 1, 1]
    with np.errstate(divide="ignore", invalid="ignore"):
        inverse = (trace + v)[:, None, None] * np.eye(2) - A
        inverse *= (norms / (v * np.sqrt(trace + 2 * v)))[:, None, None]
        condition = np.where(v > 0, norms**2 / v, np.inf)
        rows = np.where(v[:, None, None] > 0, inverse @ blocks, 0.0)
    return rows, condition
