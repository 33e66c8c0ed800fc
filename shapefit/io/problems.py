"""Many problems of one input, reported together: the first ten, and the number of the others.

Those of coordinates that are finite, but too large to compute with, or 0 for what is missing, too.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from shapefit.errors import InputError, counted
from shapefit.geometry.normalisation import LARGEST

LIMIT = 10


class Problems:
    """Counts the problems of an input, and words those that will be reported."""

    def __init__(self) -> None:
        self._told: list[tuple[int, str]] = []
        self._count = 0

    def add(self, rows: Sequence[int] | NDArray[Any], word: Callable[[int], str]) -> None:
        """Add a problem for each of the rows (ascending); `word` makes the line for a row."""
        self._count += len(rows)
        self._told += [(int(row), word(int(row))) for row in rows[:LIMIT]]

    def tell(self, line: str, row: int = 0) -> None:
        """Add one problem, worded as `line`."""
        self.add([row], lambda _: line)

    def join(self, other: Problems) -> None:
        """Add the problems of another account of the same input."""
        self._count += other._count
        self._told += other._told

    def raise_if_any(self) -> None:
        """Raise InputError with the first problems in the order of their rows."""
        if self._count:
            self._told.sort(key=lambda entry: entry[0])
            raise input_problems([line for _, line in self._told], self._count)


def input_problems(told: Sequence[str], count: int | None = None) -> InputError:
    """Build the InputError for these problems, of `count` in all; at most ten are listed."""
    shown = list(told[:LIMIT])
    more = (len(told) if count is None else count) - len(shown)
    return InputError([*shown, f"... and {more} more"] if more > 0 else shown)


AT_ZERO = 0.01
"""Share of landmarks at exactly (0, 0) from which on there is a warning."""


class Axis(NamedTuple):
    """What an axis runs over, in messages: `item` and the names of all, numbers without names."""

    kind: str
    names: Sequence[str] | None = None

    def word(self, number: int) -> str:
        """Name one entry."""
        return f"{self.kind} {number}" if not self.names else f"{self.kind} '{self.names[number]}'"


def check_magnitudes(
    place: str, points: NDArray[np.float64] | None, rows: Axis, columns: Axis
) -> None:
    """Raise InputError for points (n, 3, q) whose squares would overflow; nan is no such point."""
    if points is None:
        return
    wrong = np.argwhere((np.abs(points) > LARGEST).any(axis=1))

    def word(number: int) -> str:
        row, column = wrong[number].tolist()
        values = ", ".join(f"{value:g}" for value in points[row, :, column].tolist())
        found = f"{rows.word(row)}, {columns.word(column)} is ({values})"
        return f"{place}: {found}; correct it, or use a larger unit: the limit is {LARGEST:g}"

    problems = Problems()
    problems.add(range(len(wrong)), word)
    problems.raise_if_any()


def warn_of_zeros(points: NDArray[np.float64]) -> tuple[str, ...]:
    """Warn of many landmarks (..., 2) at exactly (0, 0), where detectors put what they miss."""
    there = (points == 0).all(axis=-1)
    if there.sum() <= AT_ZERO * there.size:
        return ()
    found = f"{int(there.sum())} of {counted(there.size, 'landmark')} are at exactly (0, 0)"
    return (f"{found}: if these were not found, leave them empty, or NaN",)
