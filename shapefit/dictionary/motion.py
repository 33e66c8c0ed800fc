"""How landmarks of training shapes move, how rigid bones are, how they differ between bodies."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Floats
from shapefit.geometry.normalisation import normalise

FEWEST = 100
"""Second differences from which a mean square is taken."""

LEAST = 1e-3
"""Floor of the result: nothing stands stiller than that on purpose."""

ALIKE = 0.02
"""Root mean square difference of the logarithms of lengths within which two sequences show one
body: motion capture finds those of a body again within 0.015."""

SPREAD, WORTH = 0.06, 5.0
"""s and m. Ten bodies of motion capture have bones that are longer or shorter by 4.5% beside their
size, and a body differs from another by 1.4 times that."""


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
    lengths, mean, of = find_lengths(shapes, edges, sequences)
    found: Floats = np.sqrt(((lengths - mean[of]) ** 2).mean(axis=0))
    return found / np.median(normalise(shapes).scale)


def find_lengths(
    shapes: Floats, edges: NDArray[np.integer], sequences: Sequence[str]
) -> tuple[Floats, Floats, NDArray[np.integer]]:
    """Lengths (n, e) of the edges, their means (s, e) in s sequences by name, and which (n,)."""
    i, j = edges.T
    lengths = np.linalg.norm(shapes[:, :, i] - shapes[:, :, j], axis=1)
    _, of = np.unique(np.array(sequences, dtype=object).astype(str), return_inverse=True)
    count = np.maximum(np.bincount(of), 1)
    mean = [np.bincount(of, column) / count for column in lengths.T]
    return lengths, np.stack(mean, axis=1) if mean else np.empty((len(count), 0)), of


def find_edge_covariance(lengths: Floats) -> Floats:
    """S = (sum_b d_b d_b^T + m s^2 I) / (n - 1 + m), d_b = log l_b - mean, of n bodies (e, e).

    lengths (q, e), mean lengths of the edges in q sequences, in any unit; those of one body
    (`ALIKE`) count once, and edges without a length differ by s alone. A few bodies say little of
    others: the spread s counts as much as m further ones would.
    """
    there = (lengths > 0).all(axis=0)
    logs = np.log(np.where(there, lengths, 1.0))
    bodies: list[Floats] = []
    for each in logs:
        if all(np.sqrt(((each - body) ** 2).mean()) > ALIKE for body in bodies):
            bodies.append(each)
    away = np.array(bodies) - np.mean(bodies, axis=0)
    e = logs.shape[1]
    found: Floats = away.T @ away + WORTH * SPREAD**2 * np.eye(e)
    return found / (len(bodies) - 1 + WORTH)
