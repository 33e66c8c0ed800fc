"""Checks of coordinates that are finite and yet too large to compute with."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from shapefit.geometry.normalisation import LARGEST
from shapefit.io.problems import Problems


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
