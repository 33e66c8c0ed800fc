"""Checks of coordinates that are finite: too large to compute with, or 0 for what is missing."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from shapefit.errors import counted
from shapefit.geometry.normalisation import LARGEST
from shapefit.io.problems import Problems

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
