"""RANSAC: the landmarks that agree with one pose of a known shape (paper, Discussion).

Fischler and Bolles, CACM 1981, with the truncated sum of MSAC (Torr and Zisserman, CVIU
2000), local optimisation (Chum, Matas and Kittler, DAGM 2003) and a count of chance
agreements in the spirit of Moisan and Stival, IJCV 2004.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from shapefit import core
from shapefit.arrays import Floats


def find_consensus(
    landmarks: Floats,
    weights: Floats,
    shape: Floats,
    seeds: NDArray[np.uint64],
    *,
    threshold: float,
    draws: int,
    max_rounds: int,
    threads: int = 0,
) -> NDArray[np.bool_]:
    """Return the inliers (n, p): landmarks that agree with one pose of the shape.

    Poses are those of weak perspective. landmarks (n, 2, p) in any unit; weights (n,
    p), 0 = hidden; shape (3, p), such as the mean shape; seeds (n,), on which alone the
    draws of an image depend. A landmark agrees where its residual is at most threshold
    times the size of the posed shape. Poses of `draws` random triples compete; each
    that takes the lead is fitted to its inliers, and these are judged again,
    `max_rounds` times at most. An image has no inliers where no triple determines a
    pose.
    """
    n, _, p = landmarks.shape
    visible = weights > 0
    square = weights**2
    count = np.maximum(visible.sum(axis=1, keepdims=True), 1)
    mean = square.sum(axis=1, keepdims=True) / count
    square = np.divide(square, mean, out=np.zeros_like(square), where=visible)
    inliers = np.zeros((n, p), dtype=bool)
    core.find_consensus(
        landmarks=np.ascontiguousarray(np.where(visible[:, None], landmarks, 0.0)),
        squares=np.ascontiguousarray(square),
        shape=np.ascontiguousarray(shape, np.float64),
        seeds=np.ascontiguousarray(seeds, np.uint64),
        threshold=threshold,
        draws=draws,
        max_rounds=max_rounds,
        inliers=inliers,
        threads=threads,
    )
    return inliers
