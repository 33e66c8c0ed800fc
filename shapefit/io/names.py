"""Names of landmarks, matched and renamed; names of items, found and compared by hashes."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from hashlib import blake2b
from itertools import chain
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from shapefit.errors import abbreviate, input_error
from shapefit.io.checks import LIMIT, input_problems

KEY = "rename"

MOST_COMPARED = 1000
"""Known names that a name is compared with, to say which it is like."""


def match_landmarks(
    have: Sequence[str], want: Sequence[str], place: str = "landmark_names"
) -> NDArray[np.intp]:
    """Return i with have[i[j]] == want[j] for every j.

    Raises InputError at `place` with the nearest names for every wanted name that is not there.
    """
    index = {name: number for number, name in enumerate(have)}
    strange = [name for name in want if name not in index]
    stripped = {name.strip() for name in have}
    if spaced := [repr(name) for name in strange if name.strip() in stripped]:
        found = f"names of landmarks differ from the known ones in spaces ({_some(spaced)})"
        raise input_error(place, found, "remove the spaces around names")
    if len(strange) == len(want) > 1:
        found = (
            f"none of the {len(want)} landmarks ({_some(want)}) is known; known are {_some(have)}"
        )
        raise input_error(place, found, "give files with the same landmark names")
    if strange:
        told = [_strange_landmark(place, name, have) for name in strange[:LIMIT]]
        raise input_problems(told, len(strange))
    return np.array([index[name] for name in want], dtype=np.intp)


def nearest_names(name: str, known: Sequence[str]) -> list[str]:
    """Return the up to three known names that look most like a name."""
    return get_close_matches(name, known[:MOST_COMPARED], n=3, cutoff=0.5)


def renamed(names: tuple[str, ...], rename: Mapping[str, str], place: str) -> tuple[str, ...]:
    """Return the names after `rename` (old name -> new).

    Raises InputError at `place` where two landmarks would have one name.
    """
    first: dict[str, str] = {}
    for before in names:
        after = rename.get(before, before)
        if after in first:
            found = f"`{KEY}` gives the name '{after}' to '{first[after]}' and '{before}'"
            raise input_error(place, found, "give every landmark a unique name")
        first[after] = before
    return tuple(first)


def check_known(rename: Mapping[str, str], files: Sequence[tuple[str, Sequence[str]]]) -> None:
    """Raise InputError where `rename` names landmarks that no file (name, landmarks) has."""
    known = list(dict.fromkeys(name for _, names in files for name in names))
    unknown = [name for name in rename if name not in set(known)]
    if not unknown:
        return
    near = {name: nearest_names(name, known) for name in unknown[:LIMIT]}
    hints = [
        f"'{name}' -> {' or '.join(map(repr, close))}" for name, close in near.items() if close
    ]
    found = f"{', '.join(place for place, _ in files)}: no landmark {abbreviate(unknown)}"
    meant = f"did you mean {', '.join(hints)}?" if hints else f"there are {abbreviate(known)}"
    raise input_error(KEY, found, meant)


def _strange_landmark(place: str, name: str, known: Sequence[str]) -> str:
    nearest = nearest_names(name, known)
    if nearest:
        fix = "did you mean " + " or ".join(f"'{near}'" for near in nearest) + "?"
    else:
        fix = f"use one of: {_some(known)}"
    return f"{place}: there is no landmark '{name}'; {fix}"


def _some(names: Sequence[str]) -> str:
    return ", ".join(names[:10]) + (", ..." if len(names) > 10 else "")


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
