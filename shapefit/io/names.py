"""Names of landmarks, matched and renamed; names of items, compared by hashes."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from difflib import get_close_matches
from itertools import chain

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
    if len(absent) == len(want) > 1:
        none = f"none of the {len(want)} landmarks ({abbreviate(want, 10)}) is known"
        fix = "give files with the same landmark names"
        raise input_error(place, f"{none}; known are {abbreviate(have, 10)}", fix)
    if absent:
        problems = []
        for name in absent[:LIMIT]:
            near = " or ".join(f"'{other}'" for other in nearest_names(name, have))
            fix = f"did you mean {near}?" if near else f"use one of: {abbreviate(have, 10)}"
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
            fault = f"`rename` gives the name '{after}' to '{first[after]}' and '{before}'"
            raise input_error(place, fault, "give every landmark a unique name")
        first[after] = before
    return tuple(first)


def find_shared_item(
    files: Sequence[tuple[Callable[[], Iterable[Sequence[str]]], Callable[[str, int], str]]],
) -> str | None:
    """Return an item that two files have; None where there is none.

    Each file comes with what reads its items, block by block, and what names a row of a dataset.
    Raises InputError for items without a name, and for those that occur twice in a file. Only names
    whose hash is there twice are read again and compared: 8 bytes for each item.
    """

    def rows() -> Iterator[tuple[int, int, str]]:
        for number, (blocks, _) in enumerate(files):
            names = chain.from_iterable(blocks())
            yield from ((number, row, name) for row, name in enumerate(names))

    def place(number: int, row: int) -> str:
        return files[number][1]("item", row)

    hashes = np.sort(np.fromiter((hash(name) for *_, name in rows()), np.int64))
    again = {hash(""), *hashes[1:][hashes[1:] == hashes[:-1]].tolist()}
    first: dict[str, tuple[int, int]] = {}
    shared, problems = None, []
    for number, row, name in rows() if len(again) > 1 or hash("") in hashes else ():
        if hash(name) not in again:
            continue
        if not name:
            problems.append(f"{place(number, row)}: is empty; name every item")
        elif name in first and first[name][0] == number:
            where = f"item '{name}' is also at {place(*first[name])}"
            problems.append(f"{place(number, row)}: {where}; give every item a unique name")
        elif name in first:
            shared = shared or name
        first[name] = number, row
    if problems:
        raise input_problems(problems)
    return shared
