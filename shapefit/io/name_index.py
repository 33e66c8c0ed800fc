"""Names of items by their 64-bit hashes: where a name is, and which are there twice."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from hashlib import blake2b
from itertools import chain
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from shapefit.io.problems import LIMIT, input_problems

MOST_NAMED = 3
"""Names that are given as examples."""

Hashes = NDArray[np.uint64]
Blocks = Callable[[], Iterable[Sequence[str]]]
"""Reads the names of a list anew, block by block."""

Place = tuple[int, int]
"""The number of a list, and a row of it."""


def hashed(names: Sequence[str]) -> Hashes:
    """Return the hash of each name, which is another one in every run of the program."""
    return np.fromiter(map(hash, names), np.int64, len(names)).view(np.uint64)


def stable_hashes(names: Iterable[str]) -> Hashes:
    """Return another hash of each name, the same in all processes."""
    encoded = (name.encode("utf-8", "surrogatepass") for name in names)
    return np.frombuffer(b"".join(blake2b(e, digest_size=8).digest() for e in encoded), np.uint64)


class NameIndex:
    """Names by their hashes, eight bytes each: in which row, from 0, each of them is.

    Two names of one hash are taken for one: of a million names that happens once in 40 million
    runs.
    """

    def __init__(self, hashes: Hashes) -> None:
        self._order = np.argsort(hashes, kind="stable")
        self._sorted = hashes[self._order]

    @classmethod
    def of(cls, blocks: Iterable[Sequence[str]]) -> NameIndex:
        """Return the index of the names in these blocks."""
        return cls(np.concatenate([np.empty(0, np.uint64), *map(hashed, blocks)]))

    def __len__(self) -> int:
        return len(self._order)

    def find(self, names: Sequence[str]) -> NDArray[np.intp]:
        """Row of each name, -1 for one that is not there."""
        wanted = hashed(names)
        places = np.searchsorted(self._sorted, wanted)
        near = np.minimum(places, max(len(self) - 1, 0))
        found = self._order[near] if len(self) else np.full(len(wanted), -1)
        there = self._sorted[near] == wanted if len(self) else np.zeros(len(wanted), bool)
        return np.where(there, found, -1).astype(np.intp)


def repeated(hashes: Hashes) -> Hashes:
    """Return the hashes that are there twice or more."""
    together = np.sort(hashes)
    twice = together[1:][together[1:] == together[:-1]]
    new = np.ones(len(twice), np.bool_)  # np.unique would import numpy.ma
    new[1:] = twice[1:] != twice[:-1]
    return twice[new]


def repetitions(lists: Sequence[Blocks]) -> Iterator[tuple[str, Place, Place, Place]]:
    """Yield each name that is there again: where it was first and last, and where it is.

    Only names whose hash is there twice are read again and compared.
    """
    every = chain.from_iterable(blocks() for blocks in lists)
    hashes = repeated(np.concatenate([np.empty(0, np.uint64), *map(hashed, every)]))
    if not len(hashes):
        return
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


def check_unique(files: Sequence[tuple[Blocks, Callable[[int], str]]]) -> None:
    """Raise InputError for items that occur more than once, naming both places.

    Each file comes with what reads its items, and what names a row of it.
    """
    told: list[str] = []
    count = 0
    for item, first, _, again in repetitions([blocks for blocks, _ in files]):
        count += 1
        if len(told) < LIMIT:
            one, other = (files[number][1](row) for number, row in (first, again))
            told.append(f"{other}: item '{item}' is also at {one}; give every item a unique name")
    if count:
        raise input_problems(told, count)


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


def find_equal_names(lists: Mapping[Path, Blocks]) -> Equal:
    """Return the names that are in two or more of these lists, each of which a file holds."""
    files, found = list(lists), Equal(0, ())
    for name, (first, _), (last, _), (number, _) in repetitions(list(lists.values())):
        if first == last != number:
            found += Equal(1, ((name, files[first], files[number]),))
    return found
