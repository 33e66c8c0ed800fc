"""Mean, median and percentiles of numbers that need not fit in memory: exact, over several passes.

What is sliced, here and in what uses it, is an array or anything else that gives arrays by slices.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from shapefit.evaluation.statistics.selection import select

Floats = NDArray[np.float64]

AT_ONCE = 1 << 20
"""Numbers that are in memory at a time; as many are summed pairwise."""


class Sliced(Protocol):
    """Numbers (n,) that are read by slices: an array, or a column in a file."""

    def __len__(self) -> int: ...

    def __getitem__(self, rows: slice, /) -> NDArray[Any]: ...


@dataclass(frozen=True)
class Sample:
    """So many numbers, none of them nan; `blocks` reads them anew, in their order."""

    count: int
    blocks: Callable[[], Iterator[Floats]]


def slices(count: int, most: int | None = None) -> Iterator[slice]:
    """Cut the rows 0..count - 1 into slices of at most so many, by default `AT_ONCE`."""
    size = AT_ONCE if most is None else most
    return (slice(start, min(start + size, count)) for start in range(0, count, size))


def mean(sample: Sample) -> float:
    """Sum x_i / n; nan of nothing. Within some 1e-15 of the sum of the absolute values."""
    if not sample.count:
        return float("nan")
    return float(np.sum([block.sum() for block in sample.blocks()]) / sample.count)


def median(sample: Sample) -> float:
    """Return what `numpy.median` does, to the last bit; nan of nothing."""
    if not sample.count:
        return float("nan")
    middle = sorted({(sample.count - 1) // 2, sample.count // 2})
    return float(np.median(in_order(sample, middle)))


def percentiles(sample: Sample, shares: Sequence[float]) -> tuple[float, ...]:
    """Return what `numpy.percentile` does, to the last bit; nan of nothing."""
    return tuple(between for _, _, between in neighbours(sample, shares))


def neighbours(sample: Sample, shares: Sequence[float]) -> list[tuple[float, float, float]]:
    """Numbers just below and above each percentile, and the percentile, which is between them."""
    if not sample.count:
        return [(float("nan"),) * 3 for _ in shares]
    places = (sample.count - 1) * np.true_divide(shares, 100)
    below = np.floor(places).astype(np.int64)
    above = np.minimum(below + 1, sample.count - 1)
    values = in_order(sample, [*below.tolist(), *above.tolist()]).reshape(2, -1).T
    return [
        (float(a), float(b), float(np.quantile((a, b), rest)))
        for (a, b), rest in zip(values, places - below, strict=True)
    ]


def in_order(sample: Sample, ranks: Sequence[int]) -> Floats:
    """Numbers at these places of the ascending order, counted from 0."""
    return select(sample.count, sample.blocks, ranks, AT_ONCE)
