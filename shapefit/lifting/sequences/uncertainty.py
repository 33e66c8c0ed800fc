"""How uncertain the frames of a smoothed sequence are: the diagonal of the inverse Hessian."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from shapefit.lifting.sequences.banded import DIFFERENCE
from shapefit.lifting.sequences.observations import Observations
from shapefit.lifting.sequences.smoothing import Model, Smoothed, normal_blocks

Floats = NDArray[np.float64]


MIXED = ((0, 1), (0, 2), (1, 2))
"""Pairs of coordinates of a landmark, in the order of the correlations."""


def deviations(
    seen: Observations, model: Model, noise: float, found: Smoothed
) -> tuple[Floats, Floats]:
    """Standard deviations (t, 3, p) of the points, the lengths of the bones held, and correlations.

    The correlations (t, 3, p) are those of x with y, x with z, and y with z of each landmark.

    Pairs of frames are one state, tied to the next pair only. With blocks A_k of the pairs and
    B_k between pair k and k + 1

        D_k = A_k - B_(k-1)^T D_(k-1)^-1 B_(k-1),
        V_k = D_k^-1 + D_k^-1 B_k V_(k+1) B_k^T D_k^-1,

    and V_k holds the covariances of the frames of pair k.
    """
    blocks, stiffness = normal_blocks(seen, model, noise, found)
    t, d, _ = blocks.shape
    diagonal, beside = in_pairs(blocks, stiffness)
    count = len(diagonal)
    inverse: list[Floats] = []
    for k in range(count):
        D = diagonal[k]
        if k:
            D = D - beside[k - 1].T @ inverse[-1] @ beside[k - 1]
        inverse.append(np.linalg.inv(D))
    variance, mixed = np.empty((count, 2 * d)), np.empty((count, 2 * d))
    every = np.arange(d).reshape(3, -1)
    one, other = (
        np.concatenate([half + every[[pair[i] for pair in MIXED]].ravel() for half in (0, d)])
        for i in (0, 1)
    )
    V = inverse[-1]
    for k in range(count - 1, -1, -1):
        if k < count - 1:
            G = inverse[k] @ beside[k]
            V = inverse[k] + G @ V @ G.T
        variance[k], mixed[k] = np.diag(V), V[one, other]
    spread = np.sqrt(np.maximum(variance, 0.0)).reshape(2 * count, 3, d // 3)[:t]
    covariance = mixed.reshape(2 * count, 3, d // 3)[:t]
    first, second = (spread[:, [pair[i] for pair in MIXED]] for i in (0, 1))
    return spread, covariance / np.maximum(first * second, 1e-300)


def in_pairs(blocks: Floats, stiffness: Floats) -> tuple[Floats, Floats]:
    """Blocks A (m, 2d, 2d) of pairs of frames and B (m - 1, 2d, 2d) between them.

    The last pair of an odd number of frames is filled up with a frame of its own.
    """
    t, d, _ = blocks.shape
    m = (t + 1) // 2
    ties = np.zeros((2 * m, 3))  # of frame f with f, f + 1, f + 2, by the stiffness
    for a, left in enumerate(DIFFERENCE if t > 2 else ()):
        for b, right in enumerate(DIFFERENCE[: a + 1]):
            ties[b : b + t - 2, a - b] += left * right
    A = np.zeros((m, 2, d, 2, d))
    B = np.zeros((max(m - 1, 0), 2, d, 2, d))
    every = np.arange(d)
    for f in range(2 * m):
        k, half = divmod(f, 2)
        A[k, half, :, half] = blocks[f] if f < t else np.eye(d)
        A[k, half, every, half, every] += stiffness * ties[f, 0]
        if half == 0:
            A[k, 0, every, 1, every] += stiffness * ties[f, 1]
            A[k, 1, every, 0, every] += stiffness * ties[f, 1]
        elif k < m - 1:
            B[k, 1, every, 0, every] += stiffness * ties[f, 1]
        if k < m - 1:
            B[k, half, every, half, every] += stiffness * ties[f, 2]
    return A.reshape(m, 2 * d, 2 * d), B.reshape(-1, 2 * d, 2 * d)
