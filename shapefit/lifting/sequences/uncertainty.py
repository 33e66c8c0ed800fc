"""How uncertain the frames of a smoothed sequence are: the diagonal of the inverse Hessian."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from shapefit.lifting.sequences.banded import DIFFERENCE
from shapefit.lifting.sequences.observations import Observations
from shapefit.lifting.sequences.smoothing import Model, Smoothed, normal_blocks

Floats = NDArray[np.float64]


def deviations(seen: Observations, model: Model, noise: float, found: Smoothed) -> Floats:
    """Standard deviations (t, 3, p) of the points, the lengths of the bones held.

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
    variance = np.empty((count, 2 * d))
    V = inverse[-1]
    variance[-1] = np.diag(V)
    for k in range(count - 2, -1, -1):
        G = inverse[k] @ beside[k]
        V = inverse[k] + G @ V @ G.T
        variance[k] = np.diag(V)
    by_frame = variance.reshape(2 * count, d)[:t]
    spread: Floats = np.sqrt(np.maximum(by_frame, 0.0)).reshape(t, 3, d // 3)
    return spread


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
