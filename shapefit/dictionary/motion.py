"""How landmarks of training shapes move, how rigid bones are, how they differ between bodies."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

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


@dataclass(frozen=True)
class Lengths:
    """Of the edges in one sequence: number of shapes, mean and sum of squared differences (e,)."""

    count: int
    mean: Floats
    squares: Floats

    def __add__(self, other: Lengths) -> Lengths:
        """Join the shapes of two. Source: Chan, Golub and LeVeque 1979."""
        count = self.count + other.count
        apart = other.mean - self.mean
        return Lengths(
            count,
            self.mean + apart * (other.count / count),
            self.squares + other.squares + apart**2 * (self.count * other.count / count),
        )


@dataclass
class MotionSums:
    """Sums over shapes, block by block, for what `find_acceleration` and `find_give` find at once.

    edges (e, 2). What it keeps grows with the number of sequences, not with that of the shapes.
    """

    edges: NDArray[np.integer]
    squares: Floats | float = 0.0
    count: int = 0
    last: Floats | None = None
    names: tuple[str, ...] = ()
    lengths: dict[str, Lengths] = field(default_factory=dict)

    def add(self, shapes: Floats, sequences: Sequence[str]) -> None:
        """Add shapes (n, 3, p) with their sequences (n,); they follow those before."""
        y = shapes - shapes.mean(axis=2, keepdims=True)
        y = y if self.last is None else np.concatenate([self.last, y])
        names = np.array((*self.names, *sequences), dtype=object)
        together = (names[2:] == names[1:-1]) & (names[1:-1] == names[:-2])
        second = (y[2:] - 2 * y[1:-1] + y[:-2])[together]
        self.squares += (second**2).sum(axis=(0, 1))
        self.count += len(second)
        self.last, self.names = y[-2:], tuple(names[-2:])
        i, j = self.edges.T
        lengths = np.linalg.norm(shapes[:, :, i] - shapes[:, :, j], axis=1)
        numbers = np.array(sequences, dtype=object)
        for name in dict.fromkeys(sequences):
            own = lengths[numbers == name]
            mean = own.mean(axis=0)
            found = Lengths(len(own), mean, ((own - mean) ** 2).sum(axis=0))
            self.lengths[name] = self.lengths[name] + found if name in self.lengths else found

    def acceleration(self, unit: float) -> Floats | None:
        """Return what `find_acceleration` finds, where `unit` is the median size of the shapes."""
        if self.count < FEWEST:
            return None
        found: Floats = np.maximum(np.sqrt(self.squares / (3 * self.count)) / unit, LEAST)
        return found

    def give(self, unit: float) -> Floats:
        """Return what `find_give` finds, where `unit` is the median size of the shapes."""
        count = sum(each.count for each in self.lengths.values())
        squares = sum(each.squares for each in self.lengths.values())
        found: Floats = np.sqrt(squares / count) / unit
        return found

    def mean_lengths(self) -> Floats:
        """Return the mean lengths (s, e) of the edges in s sequences, as `find_lengths` does."""
        return np.array([self.lengths[name].mean for name in sorted(self.lengths)])
