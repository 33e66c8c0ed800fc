"""Arrays by the names that signatures use, their median, and rows that go together.

Docstrings give the axes of an array.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
Integers = NDArray[np.int64]
Flags = NDArray[np.bool_]
Indices = NDArray[np.intp]

Numbers = NDArray[np.floating] | NDArray[np.integer]
"""Real numbers of any type."""


def median(values: Numbers) -> float:
    """Return the median of numbers (n,), at least one."""
    # np.median imports masked arrays, which takes 0.06 s at its first call
    ordered = np.sort(values)
    lower = ordered[(len(ordered) - 1) // 2]
    upper = ordered[len(ordered) // 2]
    return float((lower + upper) / 2)


def finite_median(values: Numbers, default: float = float("nan")) -> float:
    """Return the median of the finite numbers of `values` (n,), else the default."""
    finite = values[np.isfinite(values)]
    return median(finite) if len(finite) else default


MAX_EXACT = 2.0**53
"""Whole numbers as large as this, and larger ones, are not told apart."""


def are_whole(numbers: Floats) -> Flags:
    """Return which numbers (n,) are whole and below `MAX_EXACT` in size."""
    whole: Flags = (np.abs(numbers) < MAX_EXACT) & (np.trunc(numbers) == numbers)
    return whole


def split_runs(is_new: Flags, count: int) -> list[slice]:
    """Split `count` rows into slices, which begin where `is_new` (count - 1,) is true.

    is_new: whether a row, from the second on, begins another slice. [] for no row.
    """
    if not count:
        return []
    starts = np.flatnonzero(is_new) + 1
    return [
        slice(start, stop) for start, stop in pairwise([0, *starts.tolist(), count])
    ]


def evenly(n: int, max_count: int) -> NDArray[np.intp]:
    """Return up to `max_count` indices, spread evenly over 0 to n - 1."""
    rows = np.linspace(0, n - 1, min(n, max_count)).astype(np.intp)
    # np.unique imports masked arrays too
    is_new = np.diff(rows, prepend=-1) > 0
    return rows[is_new]
