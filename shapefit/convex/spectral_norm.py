"""Spectral norm of 2x3 blocks and its dual norm, in closed form.

For a block Q with A = Q Q^T and r = sqrt(det A) = |q_1 x q_2| (the rows' cross product) the
singular values satisfy s1 + s2 = sqrt(tr A + 2 r) and (s1 + s2)(s1 - s2) = sqrt((A11 - A22)^2 +
4 A12^2), which stays exact where the two are equal; no SVD is needed.
"""

from __future__ import annotations

import numpy as np

from shapefit.arrays import Floats


def sum_and_difference(Q: Floats) -> tuple[Floats, Floats, Floats]:
    """Return s1 + s2, s1 - s2 and s1 s2 of blocks (..., 2, 3)."""
    first, second = Q[..., 0, :], Q[..., 1, :]
    product = np.linalg.norm(np.cross(first, second), axis=-1)
    A11, A22 = (first**2).sum(axis=-1), (second**2).sum(axis=-1)
    total = np.sqrt(A11 + A22 + 2 * product)
    spread = np.hypot(A11 - A22, 2 * (first * second).sum(axis=-1))
    return total, np.divide(spread, total, out=np.zeros_like(total), where=total > 0), product


def spectral_norm(Q: Floats) -> Floats:
    """||Q||_2 = s1, the largest singular value of blocks (..., 2, 3)."""
    total, difference, _ = sum_and_difference(Q)
    return (total + difference) / 2


def nuclear_norm(Q: Floats) -> Floats:
    """||Q||_* = s1 + s2, the dual norm of the spectral norm, of blocks (..., 2, 3)."""
    return sum_and_difference(Q)[0]
