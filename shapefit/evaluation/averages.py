"""Means and percentiles of numbers, of all or by the names that they have; nan of nothing.

What is sliced is an array, or anything else that gives arrays by slices, such as a column in a
file: one column at a time is read whole.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Floats


class Sliced(Protocol):
    """Numbers (n,) that are read by slices: an array, or a column in a file."""

    def __len__(self) -> int: ...

    def __getitem__(self, rows: slice, /) -> NDArray[Any]: ...


@dataclass(frozen=True)
class Labels:
    """Names of n values: names, each once, and codes (n,), the place of each value's among them."""

    names: tuple[str, ...]
    codes: Sliced

    def __len__(self) -> int:
        return len(self.codes)

    def __getitem__(self, rows: slice) -> tuple[str, ...]:
        return tuple(self.names[code] for code in self.codes[rows].tolist())

    def among(self, names: Iterable[str]) -> NDArray[np.bool_]:
        """Whether the name of each value (n,) is one of these."""
        wanted = frozenset(names)
        found = np.array([name in wanted for name in self.names], dtype=np.bool_)
        return found[self.codes[:]]


class Coder:
    """Gives each new name the next code."""

    def __init__(self) -> None:
        self._codes: dict[str, int] = {}

    def __call__(self, names: Sequence[str]) -> NDArray[np.int32]:
        """Return the codes of names."""
        for name in dict.fromkeys(names):
            self._codes.setdefault(name, len(self._codes))
        return np.fromiter(map(self._codes.__getitem__, names), np.int32, len(names))

    @property
    def names(self) -> tuple[str, ...]:
        """Return the names so far, in the order of their codes."""
        return tuple(self._codes)


def labels_of(names: Sequence[str]) -> Labels:
    """Return these names as labels."""
    coder = Coder()
    codes = coder(names)
    return Labels(coder.names, codes)


def of_names(values: Sliced, labels: Labels, names: Iterable[str]) -> Floats:
    """Return the values, nan left out, whose label is one of the names."""
    return without_nan(values[:][labels.among(names)])


def by_name(values: Sliced, labels: Labels) -> Iterator[tuple[str, int, Floats]]:
    """Each name that a value has, the number of its values, and those of them that are not nan."""
    codes = labels.codes[:]
    sizes = np.bincount(codes, minlength=len(labels.names))
    ordered = values[:][np.argsort(codes, kind="stable")]
    for name, own in zip(labels.names, np.split(ordered, np.cumsum(sizes)[:-1]), strict=True):
        if len(own):
            yield name, len(own), without_nan(own)


def without_nan(values: Floats) -> Floats:
    """Return the values that are not nan, in their order."""
    return values[~np.isnan(values)]


def mean(values: Floats) -> float:
    """Sum x_i / n; nan of nothing."""
    return float(values.mean()) if len(values) else float("nan")


def median(values: Floats) -> float:
    """Return the median; nan of nothing."""
    return float(np.median(values)) if len(values) else float("nan")


def percentiles(values: Floats, shares: Sequence[float]) -> tuple[float, ...]:
    """Return a percentile for each share in percent; nan of nothing."""
    return tuple(np.percentile(values, shares).tolist() if len(values) else [np.nan] * len(shares))


TOGETHER = 1 << 10
"""Images that are measured together: what is made of them stays in the processor's cache."""


def in_blocks(measure: Callable[..., Any], *arrays: NDArray[Any] | None) -> Any:
    """Return what a function of images, on their first axis, makes of arrays; some at a time.

    It returns an array (n, ...) or a tuple of them.
    """
    parts = [
        measure(*(None if array is None else array[rows] for array in arrays))
        for rows in slices(len(next(a for a in arrays if a is not None)), TOGETHER)
    ]
    if isinstance(parts[0], tuple):
        return tuple(map(np.concatenate, zip(*parts, strict=True)))
    return np.concatenate(parts)


def slices(count: int, most: int) -> Iterator[slice]:
    """Cut the rows 0..count - 1 into slices of at most so many."""
    return (slice(start, min(start + most, count)) for start in range(0, count, most))
