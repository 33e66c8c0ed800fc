"""Names of landmarks, matched and renamed; names of items, compared by hashes."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from difflib import get_close_matches
from itertools import chain, pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from shapefit.errors import abbreviate, input_error
from shapefit.io.checks import LIMIT, input_problems

MOST_COMPARED = 1000
"""Names that a name is compared with, to say which it is like."""


def match_landmarks(
    have: Sequence[str], want: Sequence[str], place: str = "landmark_names"
) -> NDArray[np.intp]:
    """Return i with have[i[j]] == want[j] for every j.

    Raises InputError at `place` with the nearest names for every wanted name that is not there.
    """
    index = {name: number for number, name in enumerate(have)}
    absent = [name for name in want if name not in index]
    stripped = {name.strip() for name in have}
    if spaced := [repr(name) for name in absent if name.strip() in stripped]:
        found = f"names of landmarks differ from the known ones in spaces ({_some(spaced)})"
        raise input_error(place, found, "remove the spaces around names")
    if len(absent) == len(want) > 1:
        none = f"none of the {len(want)} landmarks ({_some(want)}) is known"
        fix = "give files with the same landmark names"
        raise input_error(place, f"{none}; known are {_some(have)}", fix)
    if absent:
        problems = []
        for name in absent[:LIMIT]:
            near = " or ".join(f"'{other}'" for other in nearest_names(name, have))
            fix = f"did you mean {near}?" if near else f"use one of: {_some(have)}"
            problems.append(f"{place}: there is no landmark '{name}'; {fix}")
        raise input_problems(problems, len(absent))
    return np.array([index[name] for name in want], dtype=np.intp)


def nearest_names(name: str, names: Sequence[str]) -> list[str]:
    """Return the up to three of the names that look most like a name."""
    return get_close_matches(name, names[:MOST_COMPARED], n=3, cutoff=0.5)


def renamed(names: tuple[str, ...], rename: Mapping[str, str], place: str) -> tuple[str, ...]:
    """Return the names after `rename` (old name -> new).

    Raises InputError at `place` where two landmarks would have one name.
    """
    first: dict[str, str] = {}
    for before in names:
        after = rename.get(before, before)
        if after in first:
            found = f"`rename` gives the name '{after}' to '{first[after]}' and '{before}'"
            raise input_error(place, found, "give every landmark a unique name")
        first[after] = before
    return tuple(first)


def check_renamed(rename: Mapping[str, str], files: Sequence[tuple[str, Sequence[str]]]) -> None:
    """Raise InputError where `rename` names landmarks that no file (name, landmarks) has."""
    names = list(dict.fromkeys(name for _, landmarks in files for name in landmarks))
    unknown = [name for name in rename if name not in set(names)]
    if not unknown:
        return
    near = {name: nearest_names(name, names) for name in unknown[:LIMIT]}
    hints = [f"'{name}' -> {' or '.join(map(repr, some))}" for name, some in near.items() if some]
    found = f"{', '.join(file for file, _ in files)}: no landmark {abbreviate(unknown)}"
    fix = f"did you mean {', '.join(hints)}?" if hints else f"there are {abbreviate(names)}"
    raise input_error("rename", found, fix)


def _some(names: Sequence[str]) -> str:
    return ", ".join(names[:10]) + (", ..." if len(names) > 10 else "")


Blocks = Callable[[], Iterable[Sequence[str]]]
"""Reads the names of a list anew, block by block."""


class Shared(NamedTuple):
    """How many items are in two files or more, and one of them with the numbers of two files."""

    number: int
    item: str
    files: tuple[int, int]


def check_items(files: Sequence[tuple[Blocks, Callable[[int], str]]]) -> Shared | None:
    """Return what items of files have in common; None for nothing.

    Each file comes with what reads its items, and what names a row of it. Raises InputError for
    items without a name, and for those that occur twice in a file. Only names whose hash is there
    twice are read again and compared: 8 bytes for each item.
    """

    def rows() -> Iterator[tuple[int, int, str]]:
        for number, (blocks, _) in enumerate(files):
            names = chain.from_iterable(blocks())
            yield from ((number, row, name) for row, name in enumerate(names))

    def place(number: int, row: int) -> str:
        return files[number][1](row)

    hashes = np.sort(np.fromiter((hash(name) for *_, name in rows()), np.int64))
    twice = {hash(""), *hashes[1:][hashes[1:] == hashes[:-1]].tolist()}
    rows_of: dict[str, list[tuple[int, int]]] = {}
    for number, row, name in rows() if len(twice) > 1 or hash("") in hashes else ():
        if hash(name) in twice:
            rows_of.setdefault(name, []).append((number, row))
    if empty := rows_of.pop("", []):
        raise input_problems([f"{place(*where)}: is empty; name every item" for where in empty])
    again = sorted(
        (later, earlier, item)
        for item, found in rows_of.items()
        for earlier, later in pairwise(found)
        if earlier[0] == later[0]
    )
    if again:
        fix = "give every item a unique name"
        problems = [
            f"{place(*later)}: item '{item}' is also at {place(*earlier)}; {fix}"
            for later, earlier, item in again[:LIMIT]
        ]
        raise input_problems(problems, len(again))
    shared = [(i, found[0][0], found[1][0]) for i, found in rows_of.items() if len(found) > 1]
    return Shared(len(shared), shared[0][0], shared[0][1:]) if shared else None
