"""Values by the names that they have, many the same, such as those of sequences."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from shapefit.evaluation.statistics import samples
from shapefit.evaluation.statistics.samples import Floats, Sample, Sliced, slices


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
        """Which of `names` (m,) are these."""
        wanted = frozenset(names)
        return np.array([name in wanted for name in self.names], dtype=np.bool_)


class Coder:
    """Gives each new name the next code."""

    def __init__(self) -> None:
        self._codes: dict[str, int] = {}

    def __call__(self, names: Sequence[str]) -> NDArray[np.int32]:
        """Return the codes of names."""
        codes = self._codes
        return np.fromiter(
            (codes.setdefault(name, len(codes)) for name in names), np.int32, len(names)
        )

    @property
    def names(self) -> tuple[str, ...]:
        """Return the names so far, in the order of their codes."""
        return tuple(self._codes)


def labels_of(names: Sequence[str]) -> Labels:
    """Return these names as labels."""
    coder = Coder()
    codes = coder(names)
    return Labels(coder.names, codes)


def of_names(values: Sliced, labels: Labels, names: Iterable[str]) -> Sample:
    """Return the values, nan left out, whose label is one of the names."""
    wanted = labels.among(names)
    every = slice(0, len(values))
    count = sum(len(block) for _, block in _blocks(values, labels, wanted, every))
    return _sample(count, values, labels, wanted, every)


def by_name(values: Sliced, labels: Labels) -> Iterator[tuple[str, int, Sample]]:
    """Each name that a value has, the number of its values, and those of them that are not nan.

    As many names are read together as fit in memory, and no rows but those from the first to the
    last that has one of them.
    """
    m = len(labels.names)
    total, known = np.zeros(m, np.int64), np.zeros(m, np.int64)
    first, last = np.full(m, len(values)), np.full(m, -1)
    for rows in slices(len(values)):
        codes, block = labels.codes[rows], values[rows]
        total += np.bincount(codes, minlength=m)
        known += np.bincount(codes[~np.isnan(block)], minlength=m)
        there, places = np.unique(codes, return_index=True)
        first[there] = np.minimum(first[there], rows.start + places)
        there, places = np.unique(codes[::-1], return_index=True)
        last[there] = rows.start + len(codes) - 1 - places
    for group in _together(total):
        wanted = np.zeros(m, np.bool_)
        wanted[group] = True
        span = slice(int(first[group].min()), int(last[group].max()) + 1)
        if len(group) == 1:
            (code,) = group
            sample = _sample(int(known[code]), values, labels, wanted, span)
            yield labels.names[code], int(total[code]), sample
            continue
        codes, found = map(np.concatenate, zip(*_blocks(values, labels, wanted, span), strict=True))
        order = np.argsort(codes, kind="stable")
        starts = np.searchsorted(codes[order], group[1:])
        for code, part in zip(group, np.split(found[order], starts), strict=True):
            yield labels.names[code], int(total[code]), in_memory(part)


def in_memory(values: Floats) -> Sample:
    """Return an array without nan as a sample."""
    return Sample(len(values), lambda: iter((values,)))


def _together(total: NDArray[np.int64]) -> Iterator[list[int]]:
    """Codes whose values fit in memory together, or one whose values alone do not."""
    group: list[int] = []
    size = 0
    for code in np.flatnonzero(total).tolist():
        if group and size + total[code] > samples.AT_ONCE:
            yield group
            group, size = [], 0
        group.append(code)
        size += total[code]
    if group:
        yield group


def _sample(
    count: int, values: Sliced, labels: Labels, wanted: NDArray[np.bool_], span: slice
) -> Sample:
    """Return the values of the wanted codes in a span of rows, in memory where they fit."""

    def blocks() -> Iterator[Floats]:
        return (block for _, block in _blocks(values, labels, wanted, span))

    if count <= samples.AT_ONCE:
        return in_memory(np.concatenate([np.empty(0), *blocks()]))
    return Sample(count, blocks)


def _blocks(
    values: Sliced, labels: Labels, wanted: NDArray[np.bool_], span: slice
) -> Iterator[tuple[NDArray[np.int32], Floats]]:
    """Codes and values in a span of rows that are of the wanted codes and not nan."""
    for part in slices(span.stop - span.start):
        rows = slice(span.start + part.start, span.start + part.stop)
        codes, block = labels.codes[rows], values[rows]
        kept = wanted[codes] & ~np.isnan(block)
        yield codes[kept], block[kept]
