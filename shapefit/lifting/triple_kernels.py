"""Three landmarks drawn at random, and the weak perspective poses that they determine."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from shapefit.convex.kernel import kernel
from shapefit.lifting.rotation_kernels import complete

Floats = NDArray[np.float64]
Indices = NDArray[np.int64]
State = NDArray[np.uint64]

# Three points lie on a line where their triangle is this flat: they determine no pose.
FLAT = 1e-6


@kernel
def draw_below(state: State, m: int) -> np.int64:
    """An integer of 0..m-1, and the next state (1,): Steele, Lea and Flood's SplitMix64 (2014).

    A generator of our own, for those of NumPy cannot be made inside a kernel, and Numba's is one
    for all that runs on a thread.
    """
    state[0] += np.uint64(0x9E3779B97F4A7C15)
    z = state[0]
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    z = z ^ (z >> np.uint64(31))
    return np.int64(((z >> np.uint64(32)) * np.uint64(m)) >> np.uint64(32))


@kernel
def draw_triple(candidates: Indices, state: State, triple: Indices) -> None:
    """Three different ones of the candidates (m,), m >= 3, at random, into triple (3,)."""
    m = candidates.shape[0]
    i, j, k = draw_below(state, m), draw_below(state, m - 1), draw_below(state, m - 2)
    if j >= i:
        j += 1
    if k >= min(i, j):
        k += 1
    if k >= max(i, j):
        k += 1
    triple[0], triple[1], triple[2] = candidates[i], candidates[j], candidates[k]


@kernel
def pose_triple(w: Floats, S: Floats, triple: Indices, R: Floats) -> float:
    """The s with s Rbar (S_j - S_i) = w_j - w_i for the triple, and the two such R (2, 3, 3).

    w (2, p), S (3, p); returns 0 where the triple determines no pose. With an orthonormal basis Q
    of the plane of the triple, its normal n and s Rbar = G Q^T + a n^T, the landmarks give G, and
    rows of equal length at right angles mean a a^T = s^2 I - G G^T. That has rank one: s is the
    spectral norm of G, and a is known but for its sign, which reflects the depths.
    Source: Huttenlocher and Ullman, Recognizing solid objects by alignment, IJCV 1990.
    """
    i, j, k = triple
    Q, G = np.empty((3, 3)), np.empty((2, 2))
    base, along, height = 0.0, 0.0, 0.0
    for b in range(3):
        Q[0, b] = S[b, j] - S[b, i]
        base += Q[0, b] ** 2
    base = np.sqrt(base)
    if not base > 0.0:
        return 0.0
    for b in range(3):
        Q[0, b] /= base
        along += Q[0, b] * (S[b, k] - S[b, i])
    for b in range(3):
        Q[1, b] = S[b, k] - S[b, i] - along * Q[0, b]
        height += Q[1, b] ** 2
    height = np.sqrt(height)
    if not height > FLAT * max(base, abs(along)):
        return 0.0
    complete(Q)
    for a in range(2):
        G[a, 0] = (w[a, j] - w[a, i]) / base
        G[a, 1] = (w[a, k] - w[a, i] - along * G[a, 0]) / height
    xx, yy = G[0, 0] ** 2 + G[0, 1] ** 2, G[1, 0] ** 2 + G[1, 1] ** 2
    xy = G[0, 0] * G[1, 0] + G[0, 1] * G[1, 1]
    square = 0.5 * (xx + yy + np.sqrt((xx - yy) ** 2 + 4.0 * xy * xy))
    if not square > 0.0:
        return 0.0
    s = np.sqrt(square)
    x, y = np.sqrt(max(square - xx, 0.0)), np.copysign(np.sqrt(max(square - yy, 0.0)), -xy)
    for side in range(2):
        sign = 1.0 - 2.0 * side
        for b in range(3):
            R[side, 0, b] = (G[0, 0] * Q[0, b] + G[0, 1] * Q[1, b] + sign * x * Q[2, b]) / s
            R[side, 1, b] = (G[1, 0] * Q[0, b] + G[1, 1] * Q[1, b] + sign * y * Q[2, b]) / s
        complete(R[side])
    return float(s)
