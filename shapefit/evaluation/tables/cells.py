"""Cells of the tables of errors: how numbers are written."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Protocol

ABSENT = "–"
"""Cell of a number that does not exist."""

HOW_TO_READ_PAIRS = (
    "Each cell is mean / median over the images; of several sequences, the mean of the sequences' "
    "means and of their medians."
)


class HasMeanAndMedian(Protocol):
    """Errors summed up."""

    @property
    def mean(self) -> float:
        """The mean, nan where there is none."""

    @property
    def median(self) -> float:
        """The median, nan where there is none."""


def number(value: float | None, decimals: int) -> str:
    """Write a number, or that there is none."""
    return ABSENT if value is None or math.isnan(value) else f"{value:.{decimals}f}"


def percent(share: float, decimals: int) -> str:
    """Say 100 % only where it is all of them: digits are cut off, not rounded up."""
    unit = 10**decimals
    return f"{math.floor(100 * unit * share + 1e-9) / unit:.{decimals}f} %"


def decimals_of(values: Iterable[float]) -> int:
    """Digits after the point: three as in the paper, one from 10 on, more for tiny numbers."""
    largest = max((value for value in values if not math.isnan(value)), default=0.0)
    if largest >= 10:
        return 1
    return max(3, 2 - math.floor(math.log10(largest))) if largest > 0 else 3


def pairs(sums: Sequence[HasMeanAndMedian]) -> list[str]:
    """Write *mean / median* of each, all with as many decimals."""
    decimals = decimals_of(value for s in sums for value in (s.mean, s.median))
    return [f"{number(s.mean, decimals)} / {number(s.median, decimals)}" for s in sums]
