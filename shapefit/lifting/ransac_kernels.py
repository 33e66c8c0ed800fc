"""Poses of one shape on random triples of landmarks, and the one that the others agree with most.

What a pose s, Rbar, T tells beyond its own triple is the gain

    log(A / (pi (threshold s)^2)) (sum_j omega_j^2 max(0, 1 - r_j^2 / (threshold s)^2) - 3),

with residuals r_j = ||w_j - s Rbar S_j - T||, visible landmarks spread over an area A, and omega^2
of mean 1. The sum is the truncated one of MSAC; residuals count in units of the size of the
shape. The logarithm is the surprise of a landmark that keeps to its place, where a wrong one could
be anywhere in A: without it a shape blown up far beyond the image finds some landmarks in its
wide tolerance always. Three landmarks fit whatever they are.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from shapefit.convex.kernel import kernel
from shapefit.lifting.rotation_kernels import rotation_step
from shapefit.lifting.triple_kernels import State, draw_triple, pose_triple

Floats = NDArray[np.float64]
Indices = NDArray[np.int64]
Flags = NDArray[np.bool_]

TRIPLE = 3


@kernel
def consensus_stretch(
    W: Floats, squares: Floats, S: Floats, seeds: State, threshold: float, draws: int,
    most: int, inliers: Flags,
) -> None:  # fmt: skip
    """The inliers (n, p) of the pose of S (3, p) of largest gain, for images W (n, 2, p).

    squares omega^2 (n, p), of mean 1 where not 0, which is hidden; seeds (n,) of the draws. Each
    draw that gains more than all draws before is refitted, see settle. An image in which no
    triple determines a pose has no inliers.
    """
    p = W.shape[2]
    visible, triple = np.zeros(p, np.int64), np.zeros(TRIPLE, np.int64)
    rotations, R, T = np.empty((2, 3, 3)), np.empty((3, 3)), np.empty(2)
    judged, state = np.zeros(p, np.bool_), np.zeros(1, np.uint64)
    for image in range(W.shape[0]):
        inliers[image] = False
        seen = 0
        for j in range(p):
            if squares[image, j] > 0.0:
                visible[seen] = j
                seen += 1
        if seen < TRIPLE:
            continue
        state[0] = seeds[image]
        w, h = W[image], squares[image]
        area = find_area(w, visible[:seen])
        best_drawn, best = -np.inf, -np.inf
        for _ in range(draws):
            draw_triple(visible[:seen], state, triple)
            s = pose_triple(w, S, triple, rotations)
            if not s > 0.0:
                continue
            for side in range(2):
                R[:] = rotations[side]
                for a in range(2):
                    T[a] = w[a, triple[0]]
                    for b in range(3):
                        T[a] -= s * R[a, b] * S[b, triple[0]]
                gain = judge(w, h, S, s, R, T, threshold, area, judged)
                if gain <= best_drawn:
                    continue
                best_drawn = gain
                gain = settle(w, h, S, R, T, threshold, area, most, gain, judged)
                if gain > best:
                    best = gain
                    inliers[image] = judged


@kernel
def find_area(w: Floats, visible: Indices) -> float:
    """12 sqrt(det Cov) of the visible landmarks: the area of a rectangle with their covariance."""
    m = visible.shape[0]
    x, y, xx, yy, xy = 0.0, 0.0, 0.0, 0.0, 0.0
    for j in visible:
        x += w[0, j] / m
        y += w[1, j] / m
    for j in visible:
        xx += (w[0, j] - x) ** 2 / m
        yy += (w[1, j] - y) ** 2 / m
        xy += (w[0, j] - x) * (w[1, j] - y) / m
    return 12.0 * np.sqrt(max(xx * yy - xy * xy, 0.0))


@kernel
def judge(
    w: Floats, h: Floats, S: Floats, s: float, R: Floats, T: Floats, threshold: float,
    area: float, inliers: Flags,
) -> float:  # fmt: skip
    """The gain of a pose; the landmarks within its threshold become the inliers (p,).

    -inf, and no inliers, where the tolerance of a landmark covers the whole area.
    """
    tolerance = (threshold * s) ** 2
    inliers[:] = False
    if not np.pi * tolerance < area:
        return -np.inf
    total = -float(TRIPLE)
    for j in range(h.shape[0]):
        if h[j] > 0.0:
            x, y = w[0, j] - T[0], w[1, j] - T[1]
            for b in range(3):
                x -= s * R[0, b] * S[b, j]
                y -= s * R[1, b] * S[b, j]
            square = x * x + y * y
            if square <= tolerance:
                inliers[j] = True
                total += h[j] * (1.0 - square / tolerance)
    return total * np.log(area / (np.pi * tolerance))


@kernel
def settle(
    w: Floats, h: Floats, S: Floats, R: Floats, T: Floats, threshold: float, area: float,
    most: int, gain: float, inliers: Flags,
) -> float:  # fmt: skip
    """Fit the pose to its inliers and judge again, until they stay or `most` times.

    Returns the gain at the end; R (3, 3), T (2,) and inliers (p,) are overwritten. A pose with
    no inliers but its triple is left as it is.
    """
    P, D, before = np.empty((3, 3)), np.empty((2, 3)), np.empty(inliers.shape[0], np.bool_)
    middle, origin = np.empty(3), np.empty(2)
    for _ in range(most):
        if np.sum(inliers) <= TRIPLE:
            break
        before[:] = inliers
        find_moments(w, h, S, inliers, P, D, middle, origin)
        _, size = rotation_step(P, D, True, R)
        if not size > 0.0:
            break
        for a in range(2):
            T[a] = origin[a]
            for b in range(3):
                T[a] -= size * R[a, b] * middle[b]
        gain = judge(w, h, S, size, R, T, threshold, area, inliers)
        if np.all(inliers == before):
            break
    return gain


@kernel
def find_moments(
    w: Floats, h: Floats, S: Floats, inliers: Flags, P: Floats, D: Floats, middle: Floats,
    origin: Floats,
) -> None:  # fmt: skip
    """S Omega^2 S^T and w Omega^2 S^T of the inliers about their weighted means, and the means.

    P (3, 3), D (2, 3), the mean (3,) of the shape and that (2,) of the landmarks are written.
    """
    middle[:], origin[:], P[:], D[:] = 0.0, 0.0, 0.0, 0.0
    total = 0.0
    for j in range(h.shape[0]):
        if inliers[j]:
            total += h[j]
            for b in range(3):
                middle[b] += h[j] * S[b, j]
            for a in range(2):
                origin[a] += h[j] * w[a, j]
    middle /= total
    origin /= total
    for j in range(h.shape[0]):
        if inliers[j]:
            for b in range(3):
                moment = h[j] * (S[b, j] - middle[b])
                for a in range(3):
                    P[a, b] += moment * (S[a, j] - middle[a])
                for a in range(2):
                    D[a, b] += moment * (w[a, j] - origin[a])
