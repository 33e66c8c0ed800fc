"""Many problems of one input, reported together: the first ten, and the number of the others."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from numpy.typing import NDArray

from shapefit.errors import InputError

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
