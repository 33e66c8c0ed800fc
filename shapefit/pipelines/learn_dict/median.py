"""The median of more positive numbers than fit in memory."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


def median(batches: Iterable[Floats], count: int) -> float:
    """Return the median of `count` >= 1 positive numbers in batches (m,), exactly as NumPy does."""
    middle = [rank_value(batches, rank) for rank in ((count - 1) // 2, count // 2)]
    return float(np.mean(middle))


def rank_value(batches: Iterable[Floats], rank: int) -> float:
    """Return the number that has `rank` others before it in order, in four passes.

    The bits of positive floats, read as whole numbers, are in the same order: each pass counts 16
    of them, from the highest down, among the numbers that share those found before.
    """
    found = 0
    for shift in (48, 32, 16, 0):
        counts = np.zeros(1 << 16, np.int64)
        for numbers in batches:
            bits = np.ascontiguousarray(numbers).view(np.uint64) >> np.uint64(shift)
            alike = bits[bits >> np.uint64(16) == found]
            counts += np.bincount((alike & np.uint64(0xFFFF)).astype(np.intp), minlength=1 << 16)
        upto = np.cumsum(counts)
        digit = int(np.searchsorted(upto, rank, side="right"))
        rank -= int(upto[digit] - counts[digit])
        found = found << 16 | digit
    return float(np.array(found, np.uint64).view(np.float64))
