"""What grows while the rows of a table come in: numbered names, and arrays."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from itertools import count
from typing import Any

import numpy as np
from numpy.typing import NDArray

GROWTH = 1.25
"""Room that a growing array makes at once, as a multiple of what it holds."""


class NumberedNames:
    """The distinct texts of a column, numbered in order of appearance."""

    def __init__(self) -> None:
        self._numbers: defaultdict[str, int] = defaultdict(count().__next__)

    def __len__(self) -> int:
        return len(self._numbers)

    def number(self, cells: Sequence[str]) -> NDArray[np.int64]:
        """Return the number of the text in each cell; a new text gets the next one."""
        return np.fromiter(map(self._numbers.__getitem__, cells), np.int64, len(cells))

    def names(self) -> tuple[str, ...]:
        """Return the texts in the order of their numbers."""
        return tuple(self._numbers)


class Grid:
    """An array that grows, cheaply along its first axis; new entries hold `fill`."""

    def __init__(self, axes: int, fill: float, dtype: type[np.generic]) -> None:
        self.values: NDArray[Any] = np.empty((0,) * axes, dtype)
        self._fill = fill

    def reach(self, *shape: int) -> None:
        """Grow to at least this shape, with room along the first axis to grow again."""
        length, *others = self.values.shape
        if others != list(shape[1:]):
            wider = np.full((length, *shape[1:]), self._fill, self.values.dtype)
            wider[tuple(map(slice, self.values.shape))] = self.values
            self.values = wider
        if shape[0] > length:
            self._lengthen(int(GROWTH * shape[0]))

    def cut(self, *shape: int) -> NDArray[Any]:
        """Return the array in this shape, without the room to grow."""
        self.reach(*shape)
        self._lengthen(shape[0])
        return self.values

    def _lengthen(self, length: int) -> None:
        """Change the first axis where the array lies, so that it is never held twice."""
        before = len(self.values)
        self.values.resize((length, *self.values.shape[1:]), refcheck=False)
        self.values[before:] = self._fill
