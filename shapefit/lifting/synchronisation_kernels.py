"""One rotation shared by all transforms of an image, by a monotone fixed-point iteration."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from shapefit.convex.kernel import kernel
from shapefit.lifting.rotation_kernels import complete

Floats = NDArray[np.float64]

STARTS = 4  # the sum of all transforms, and the largest ones
STILL = 1e-13  # largest entry of the last change of Rbar
MOST_ROUNDS = 2000
RANK_ONE = 1e-8  # s1 s2 beside s1^2 + s2^2: below, the second direction is drowned by rounding


@kernel
def synchronise_stretch(M: Floats, rotations: Floats) -> None:
    """argmax sum_i max(0, <M_i, Rbar>)^2 over orthonormal rows; M (n, k, 2, 3).

    rotations (n, 3, 3) are written, and left alone where all M_i are 0. The sum is convex in
    Rbar, so that the maximiser of its linearisation, which is the polar factor of
    sum_i max(0, <M_i, Rbar>) M_i, never lowers it.
    """
    k = M.shape[1]
    R, total, norms = np.empty((3, 3)), np.empty((2, 3)), np.empty(k)
    for image in range(M.shape[0]):
        blocks = M[image]
        total[:] = 0.0
        for i in range(k):
            norms[i] = np.sum(blocks[i] ** 2)
            total += blocks[i]
        largest = -1.0
        for start in range(STARTS):
            if start > 0:
                best = np.argmax(norms)
                if norms[best] <= 0.0:
                    break
                norms[best] = 0.0
                total[:] = blocks[best]
            if not polar_rotation(total, R):
                continue
            value = climb(blocks, R, total)
            if value > largest:
                largest = value
                rotations[image] = R


@kernel
def climb(blocks: Floats, R: Floats, total: Floats) -> float:
    """Iterate from R (3, 3) to a local maximum; returns it. total (2, 3) is workspace."""
    value = 0.0
    for _ in range(MOST_ROUNDS):
        total[:] = 0.0
        value = 0.0
        for i in range(blocks.shape[0]):
            inner = 0.0
            for a in range(2):
                for b in range(3):
                    inner += blocks[i, a, b] * R[a, b]
            if inner > 0.0:
                value += inner * inner
                for a in range(2):
                    for b in range(3):
                        total[a, b] += inner * blocks[i, a, b]
        before = R.copy()
        if not polar_rotation(total, R) or np.max(np.abs(R - before)) <= STILL:
            break
    return value


@kernel
def polar_rotation(A: Floats, R: Floats) -> bool:
    """R (3, 3) with first rows (A A^T)^(-1/2) A, the polar factor of A (2, 3), completed.

    One of the nearest pairs of orthonormal rows where A has rank one; False, and R is left as
    it is, where A is 0.
    """
    xx, yy, xy = 0.0, 0.0, 0.0
    for b in range(3):
        xx += A[0, b] * A[0, b]
        yy += A[1, b] * A[1, b]
        xy += A[0, b] * A[1, b]
    trace = xx + yy
    if not trace > 0.0:
        return False
    product = np.sqrt(np.sum(np.cross(A[0], A[1]) ** 2))
    if product > RANK_ONE * trace:
        scale = 1.0 / (product * np.sqrt(trace + 2.0 * product))
        for b in range(3):
            x, y = A[0, b], A[1, b]
            R[0, b] = scale * ((yy + product) * x - xy * y)
            R[1, b] = scale * ((xx + product) * y - xy * x)
    else:  # A = sqrt(trace) u v^T: add any unit vector orthogonal to u and to v
        u0, u1 = np.sqrt(xx / trace), np.copysign(np.sqrt(yy / trace), xy)
        v = (u0 * A[0] + u1 * A[1]) / np.sqrt(trace)
        other = np.zeros(3)
        other[np.argmin(np.abs(v))] = 1.0
        other = np.cross(v, other)
        other /= np.sqrt(np.sum(other**2))
        R[0] = u0 * v - u1 * other
        R[1] = u1 * v + u0 * other
    complete(R)
    return True
