"""Names of landmarks, matched and renamed; names of items, compared by hashes."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from difflib import get_close_matches
from itertools import chain, pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from shapefit.errors import abbreviate, input_error
from shapefit.io.checks import LIMIT, input_problems, raise_at

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
        none = f"none of the {len(want)} landmarks ({_some(want)}) is known"
        fix = "give files with the same landmark names"
        raise input_error(place, f"{none}; known are {_some(have)}", fix)
    if strange:
        told = []
        for name in strange[:LIMIT]:
            near = " or ".join(f"'{each}'" for each in nearest_names(name, have))
            fix = f"did you mean {near}?" if near else f"use one of: {_some(have)}"
            told.append(f"{place}: there is no landmark '{name}'; {fix}")
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


def _some(names: Sequence[str]) -> str:
    return ", ".join(names[:10]) + (", ..." if len(names) > 10 else "")


Blocks = Callable[[], Iterable[Sequence[str]]]
"""Reads the names of a list anew, block by block."""


def repetitions(lists: Sequence[Blocks]) -> Iterator[tuple[str, list[tuple[int, int]]]]:
    """Yield each name that is there twice or more, with its places: number of a list, row of it.

    Only names whose hash is there twice are read again and compared: 8 bytes for each.
    """

    def hashed(names: Sequence[str]) -> NDArray[np.int64]:
        return np.fromiter(map(hash, names), np.int64, len(names))

    every = chain.from_iterable(blocks() for blocks in lists)
    hashes = np.sort(np.concatenate([np.empty(0, np.int64), *map(hashed, every)]))
    hashes = hashes[1:][hashes[1:] == hashes[:-1]]
    places: dict[str, list[tuple[int, int]]] = {}
    for number, blocks in enumerate(lists if len(hashes) else ()):
        start = 0
        for names in blocks():
            for row in np.flatnonzero(np.isin(hashed(names), hashes)).tolist():
                places.setdefault(names[row], []).append((number, start + row))
            start += len(names)
    return ((name, found) for name, found in places.items() if len(found) > 1)


class Shared(NamedTuple):
    """How many items are in two files or more, and one of them with the places of two files."""

    number: int
    item: str
    files: tuple[int, int]


def check_items(files: Sequence[tuple[Blocks, Callable[[int], str]]]) -> Shared | None:
    """Return what items of files have in common; None for nothing.

    Each file comes with what reads its items, and what names a row of it. Raises InputError for
    items without a name, and for those that occur twice in a file.
    """
    empty: list[str] = []

    def read(blocks: Blocks, place: Callable[[int], str]) -> Iterator[Sequence[str]]:
        start = 0
        for block in blocks():
            rows = (start + row for row, item in enumerate(block) if not item)
            empty.extend(f"{place(row)}: is empty; name every item" for row in rows)
            start += len(block)
            yield block

    met = list(repetitions([lambda f=file: read(*f) for file in files]))  # type: ignore[misc]
    again = sorted(
        (other, first, item)
        for item, places in met
        for first, other in pairwise(places)
        if first[0] == other[0]
    )
    if empty:
        raise input_problems(list(dict.fromkeys(empty)))

    def told(number: int) -> str:
        *places, item = again[number]
        one, other = (files[file][1](row) for file, row in places)
        return f"{one}: item '{item}' is also at {other}; give every item a unique name"

    raise_at(range(len(again)), told)
    return Shared(len(met), met[0][0], (met[0][1][0][0], met[0][1][1][0])) if met else None
