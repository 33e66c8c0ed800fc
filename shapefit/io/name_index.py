"""Names by their hashes: where a name is, and which are there twice, without holding them all.

The 64-bit hashes of the names are sorted in runs of some ten thousand, which are looked up one by
one. Two names may have the same hash, so that the names themselves are compared afterwards.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from hashlib import blake2b
from itertools import chain
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from shapefit.io.columns import Column, Texts
from shapefit.io.problems import LIMIT, input_problems

RUN = 1 << 16
"""Names that are sorted together: some 2 MB in memory."""

SHARES = 256
"""Equal shares of all hashes, one of which is compared over all runs at a time."""

MOST_COMPARED = 1_000_000
"""Hashes whose names are compared in one reading of the lists."""

MOST_NAMED = 3
"""Names that are given as examples."""

Hashes = NDArray[np.uint64]
Blocks = Callable[[], Iterable[Sequence[str]]]
"""Reads the names of a list anew, block by block."""

Place = tuple[int, int]
"""The number of a list, and a row of it."""


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
        self.add_hashes(hashed(names))

    def add_hashes(self, hashes: Hashes) -> None:
        """Add names by their hashes, those of all by one function."""
        self._waiting.append(hashes)
        self._count += len(hashes)
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


def stable_hashes(names: Iterable[str]) -> Hashes:
    """Return another hash of each name, the same in all processes."""
    encoded = (name.encode("utf-8", "surrogatepass") for name in names)
    return np.frombuffer(b"".join(blake2b(e, digest_size=8).digest() for e in encoded), np.uint64)


def repetitions(
    lists: Sequence[Blocks], folder: Path | None
) -> Iterator[tuple[str, Place, Place, Place]]:
    """Yield each name that is there again: where it was first and last, and where it is.

    Only names whose hash is there twice are read again and compared. Hashes that do not fit in
    memory go to an unnamed file in the folder, as a `Column` does.
    """
    for hashes in _met_twice(lists, folder):
        known: dict[str, tuple[Place, Place]] = {}
        for number, blocks in enumerate(lists):
            start = 0
            for names in blocks():
                for row in np.flatnonzero(np.isin(hashed(names), hashes)).tolist():
                    place, name = (number, start + row), names[row]
                    first, last = known.get(name, (place, place))
                    if first != place:
                        yield name, first, last, place
                    known[name] = first, place
                start += len(names)


def _met_twice(lists: Sequence[Blocks], folder: Path | None) -> Iterator[Hashes]:
    """Yield the hashes that are there twice, a limited number at a time."""
    index = index_of(folder, chain.from_iterable(blocks() for blocks in lists))
    held: list[Hashes] = []
    for hashes in index.repeated():
        held.append(hashes)
        if sum(map(len, held)) >= MOST_COMPARED:
            yield np.concatenate(held)
            held = []
    if any(map(len, held)):
        yield np.concatenate(held)


@dataclass(frozen=True)
class Equal:
    """How many names are in more than one list, and the first of them with two of their lists."""

    count: int
    examples: tuple[tuple[str, Path, Path], ...]

    def __add__(self, other: Equal) -> Equal:
        examples = sorted((*self.examples, *other.examples))[:MOST_NAMED]
        return Equal(self.count + other.count, tuple(examples))

    def __str__(self) -> str:
        named = ", ".join(f"'{item}' in {a.name} and {b.name}" for item, a, b in self.examples)
        more = self.count - len(self.examples)
        return named + (f" and {more} more" if more else "")


def find_equal_names(lists: Mapping[Path, Blocks], folder: Path | None) -> Equal:
    """Return the names that are in two or more of these lists, each of which a file holds."""
    files, found = list(lists), Equal(0, ())
    if len(files) < 2:
        return found
    for name, (first, _), (last, _), (number, _) in repetitions(list(lists.values()), folder):
        if first == last != number:
            found += Equal(1, ((name, files[first], files[number]),))
    return found


@dataclass(frozen=True)
class ItemList:
    """The items of one file: `blocks` reads them anew from the start, `place` names a row."""

    blocks: Blocks
    place: Callable[[int], str]


def check_unique_items(files: Sequence[ItemList]) -> None:
    """Raise InputError for items that occur more than once, naming both places."""
    told: list[str] = []
    count = 0
    for item, first, _, again in repetitions([file.blocks for file in files], None):
        count += 1
        if len(told) < LIMIT:
            one, other = (files[number].place(row) for number, row in (first, again))
            told.append(f"{other}: item '{item}' is also at {one}; give every item a unique name")
    if count:
        raise input_problems(told, count)
