"""How the landmarks of training shapes move from frame to frame, and how rigid their bones are."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from shapefit.geometry.normalisation import normalise

Floats = NDArray[np.float64]

FEWEST = 100
"""Second differences from which a mean square is taken."""

LEAST = 1e-3
"""Floor of the result: nothing stands stiller than that on purpose."""


def find_acceleration(shapes: Floats, sequences: Sequence[str]) -> Floats | None:
    """Root mean square over frames t and axes of y_(t-1) - 2 y_t + y_(t+1), for each landmark (p,).

    shapes (n, 3, p) in one frame; y are those shapes about their centroid, in units of their size.
    sequences (n,) name runs of frames in order of time. None where these are too few or short.
    """
    scale = normalise(shapes).scale
    unit = float(np.median(scale)) if len(scale) else 1.0
    y = (shapes - shapes.mean(axis=2, keepdims=True)) / unit
    names = np.array(sequences, dtype=object)
    together = (names[2:] == names[1:-1]) & (names[1:-1] == names[:-2])
    second = (y[2:] - 2 * y[1:-1] + y[:-2])[together]
    if len(second) < FEWEST:
        return None
    found: Floats = np.maximum(np.sqrt((second**2).mean(axis=(0, 1))), LEAST)
    return found


def find_give(shapes: Floats, edges: NDArray[np.integer], sequences: Sequence[str]) -> Floats:
    """Root mean square (e,) of how the edges' lengths differ from their means in each sequence.

    shapes (n, 3, p), edges (e, 2); in units of the size of the shapes. 0 where edges are rigid
    bones and each sequence shows one body.
    """
    scale = normalise(shapes).scale
    i, j = edges.T
    lengths = np.linalg.norm(shapes[:, :, i] - shapes[:, :, j], axis=1) / np.median(scale)
    _, of = np.unique(np.array(sequences, dtype=object).astype(str), return_inverse=True)
    count = np.maximum(np.bincount(of), 1)
    mean = np.stack([np.bincount(of, column) / count for column in lengths.T], axis=1)
    found: Floats = np.sqrt(((lengths - mean[of]) ** 2).mean(axis=0))
    return found
