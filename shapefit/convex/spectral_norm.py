"""Spectral norm of 2x3 blocks, its dual norm and its prox, in closed form.

For a block Q with A = Q Q^T and r = sqrt(det A) = |q_1 x q_2| (the rows' cross product) the
singular values satisfy s1 + s2 = sqrt(tr A + 2 r) and (s1 + s2)(s1 - s2) = sqrt((A11 - A22)^2 +
4 A12^2), which stays exact where the two are equal; no SVD is needed.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


def _sum_and_difference(Q: Floats) -> tuple[Floats, Floats, Floats]:
    """s1 + s2, s1 - s2 and s1 s2 of blocks (..., 2, 3)."""
    first, second = Q[..., 0, :], Q[..., 1, :]
    product = np.linalg.norm(np.cross(first, second), axis=-1)
    A11, A22 = (first**2).sum(axis=-1), (second**2).sum(axis=-1)
    total = np.sqrt(A11 + A22 + 2 * product)
    spread = np.hypot(A11 - A22, 2 * (first * second).sum(axis=-1))
    return total, np.divide(spread, total, out=np.zeros_like(total), where=total > 0), product


def spectral_norm(Q: Floats) -> Floats:
    """||Q||_2 = s1, the largest singular value of blocks (..., 2, 3)."""
    total, difference, _ = _sum_and_difference(Q)
    return (total + difference) / 2


def nuclear_norm(Q: Floats) -> Floats:
    """||Q||_* = s1 + s2, the dual norm of the spectral norm, of blocks (..., 2, 3)."""
    return _sum_and_difference(Q)[0]


def prox_spectral_norm(Q: Floats, t: Floats | float) -> Floats:
    """argmin_X 1/2 ||Q - X||_F^2 + t ||X||_2 for blocks (..., 2, 3) (paper, eq. prox-2norm).

    t > 0 broadcasts over the blocks. X = 0 where s1 + s2 <= t; both singular values become
    (s1 + s2 - t) / 2 where s1 - s2 <= t; otherwise only s1 falls, by t.
    """
    total, difference, product = _sum_and_difference(Q)
    A = Q @ np.swapaxes(Q, -1, -2)
    s1, s2 = (total + difference) / 2, (total - difference) / 2
    eye = np.eye(2)

    def block(scalar: NDArray[Any]) -> NDArray[Any]:
        return scalar[..., None, None]

    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        # U V^T = A^(-1/2) Q with A^(-1/2) = ((tr A + r) I - A) / (r (s1 + s2))
        trace = (A[..., 0, 0] + A[..., 1, 1]) + product
        polar = (block(trace) * eye - A) @ Q / block(product * total)
        equal = block((total - t) / 2) * polar
        # u1 u1^T = (A - s2^2 I) / (s1^2 - s2^2)
        leading = (A - block(s2**2) * eye) / block(total * difference)
        shrunk = Q - block(t / s1) * (leading @ Q)
    # In a block of rank one up to rounding U V^T is noise; there both formulas are zero up to it.
    tight = block((difference <= t) & (product > 1e-16 * total**2))
    return np.where(block(total <= t), 0.0, np.where(tight, equal, shrunk))
