"""Rotations that a result states: proper and orthonormal, and nearest to what they stand for."""

from __future__ import annotations

import numpy as np

from shapefit.arrays import Flags, Floats
from shapefit.verification.checks import FLOOR, Checks

PIVOT = 1e-6
"""Share of the trace above which no rounding makes a pivot negative."""


def check_proper(rotation: Floats, factor: Floats, checks: Checks) -> None:
    """Check that R (n, 3, 3) are rotations wherever they are stated: R^T R = I and det R = +1."""
    gram = np.abs(rotation.swapaxes(1, 2) @ rotation - np.eye(3)).reshape(len(rotation), 9)
    handed = np.abs(np.linalg.det(rotation) - 1)[:, None]
    stated = np.asarray(~np.isnan(rotation).all(axis=(1, 2)))
    off, allowed = np.concatenate([gram, handed], axis=1), np.maximum(4 * factor, 4 * FLOOR)
    checks.add("rotation is proper and orthonormal", off, allowed, of=stated)


def check_nearest(
    rotation: Floats, total: Floats, size: Floats, error: Floats, checks: Checks
) -> None:
    """Check that rotations R (n, 3, 3) are the nearest ones to A = sum_i c_i R_i.

    R maximises <R, A> over rotations where R^T A is symmetric and no two of its eigenvalues sum
    to less than 0. A is at most `error` (n,) off and of about the size (n,), 0 for no transforms:
    there R is nan.
    """
    turned = size > 0
    H = np.where(turned[:, None, None], rotation, np.eye(3)).swapaxes(1, 2) @ total
    skew = np.abs(H - H.swapaxes(1, 2))
    H = np.where(np.isfinite(H), (H + H.swapaxes(1, 2)) / 2, 0.0)
    trace = H[:, 0, 0] + H[:, 1, 1] + H[:, 2, 2]
    sums = trace[:, None, None] * np.eye(3) - H
    least, doubtful = np.zeros(len(H)), ~surely_positive(sums)
    least[doubtful] = np.linalg.eigvalsh(sums[doubtful])[:, 0]
    absent, turned = np.isnan(rotation).all(axis=(1, 2)), turned & checks.fitted
    claim = "rotation is nearest to the transforms"
    checks.hold("rotation is absent without transforms", absent, of=checks.fitted & ~turned)
    checks.add(claim, skew, 2 * error, "rotation", turned)
    checks.add(claim, -least, 3 * error, of=turned)


def surely_positive(A: Floats) -> Flags:
    """Whether A (n, 3, 3) are positive definite by far: pivots of elimination above PIVOT tr A.

    Elimination without exchanges errs by a few roundings of the trace where all pivots are above 0.
    """
    least = PIVOT * (A[:, 0, 0] + A[:, 1, 1] + A[:, 2, 2])
    first = A[:, 0, 0]
    b, c = A[:, 1, 0] / first, A[:, 2, 0] / first
    second = A[:, 1, 1] - b * A[:, 1, 0]
    e = A[:, 2, 1] - c * A[:, 1, 0]
    third = A[:, 2, 2] - c * A[:, 2, 0] - e * e / second
    return (first > least) & (second > least) & (third > least) & (least > 0)
