"""Names by their hashes: where a name is, and which are there twice, without holding them all.

The 64-bit hashes of the names are sorted in runs of some ten thousand, which are looked up one by
one. Two names may have the same hash, so that the names themselves are compared afterwards.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from shapefit.io.spilled.columns import Column
from shapefit.io.spilled.texts import Texts

RUN = 1 << 16
"""Names that are sorted together: some 2 MB in memory."""

SHARES = 256
"""Equal shares of all hashes, one of which is compared over all runs at a time."""

Hashes = NDArray[np.uint64]


@dataclass(frozen=True)
class _Run:
    """Where a sorted run is in the columns, and where each share of the hashes begins in it."""

    start: int
    stop: int
    shares: NDArray[np.int64]


class NameIndex:
    """Hashes of names that were added, each with its row, counted from 0."""

    def __init__(self, folder: Path | None) -> None:
        self._hashes = Column(folder, np.uint64)
        self._rows = Column(folder, np.int64)
        self._runs: list[_Run] = []
        self._waiting: list[Hashes] = []
        self._count = 0
        self._latest = 0

    def __len__(self) -> int:
        return self._count

    def add(self, names: Sequence[str]) -> None:
        """Add names; the first ever has the row 0."""
        self._waiting.append(hashed(names))
        self._count += len(names)
        if self._count - len(self._hashes) >= RUN:
            self._sort_waiting()

    def repeated(self) -> Iterator[Hashes]:
        """Yield the hashes that are there twice or more, which names with the same one share."""
        self._sort_waiting()
        width = SHARES if len(self._runs) == 1 else 1  # what is sorted as a whole needs no shares
        for share in range(0, SHARES, width):
            ends = [(run.start + run.shares[[share, share + width]]).tolist() for run in self._runs]
            parts = [self._hashes[start:stop] for start, stop in ends]
            together = np.sort(np.concatenate([np.empty(0, np.uint64), *parts]))
            twice = together[1:][together[1:] == together[:-1]]
            new = np.ones(len(twice), np.bool_)  # np.unique would import numpy.ma
            new[1:] = twice[1:] != twice[:-1]
            yield twice[new]

    def find(self, names: Sequence[str], known: Texts) -> NDArray[np.intp]:
        """Row of each name, -1 for one that was not added; `known` are the names by row."""
        self._sort_waiting()
        found = np.full(len(names), -1, np.intp)
        hashes = hashed(names)
        missing = np.argsort(hashes)
        # Names that come together were mostly added together, so the latest run is asked first.
        for number in np.roll(np.arange(len(self._runs)), -self._latest).tolist():
            if not len(missing):
                break
            run = self._runs[number]
            own = self._hashes[run.start : run.stop]
            first = np.searchsorted(own, hashes[missing], "left")
            sizes = np.searchsorted(own, hashes[missing], "right") - first
            if not sizes.any():
                continue
            places = np.repeat(missing, sizes)
            inside = np.repeat(first - np.cumsum(sizes) + sizes, sizes) + np.arange(sizes.sum())
            rows = self._rows[run.start : run.stop][inside]
            there = zip(places.tolist(), known.take(rows), strict=True)
            equal = np.fromiter((names[place] == name for place, name in there), bool, len(rows))
            found[places[equal]] = rows[equal]
            missing = missing[found[missing] < 0]
            self._latest = number
        return found

    def _sort_waiting(self) -> None:
        """Write the hashes that wait as a sorted run."""
        if not self._waiting:
            return
        hashes, self._waiting = np.concatenate(self._waiting), []
        order = np.argsort(hashes, kind="stable")
        hashes = hashes[order]
        start = len(self._hashes)
        bounds = np.arange(1, SHARES, dtype=np.uint64) << np.uint64(56)
        inner = np.searchsorted(hashes, bounds)
        shares = np.concatenate([[0], inner, [len(hashes)]]).astype(np.int64)
        self._hashes.append(hashes)
        self._rows.append(start + order)
        self._runs.append(_Run(start, len(self._hashes), shares))


def index_of(folder: Path | None, blocks: Iterable[Sequence[str]]) -> NameIndex:
    """Return the index of the names in these blocks."""
    index = NameIndex(folder)
    for block in blocks:
        index.add(block)
    return index


def hashed(names: Sequence[str]) -> Hashes:
    """Return the hash of each name, which is another one in every run of the program."""
    return np.fromiter(map(hash, names), np.int64, len(names)).view(np.uint64)
