"""Names of landmarks, matched and renamed; items of several files, each with a name of
its own.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from shapefit.errors import abbreviate, input_error
from shapefit.io.checks import LIMIT, input_problems
from shapefit.records.items import Record
from shapefit.records.names import as_composed

if TYPE_CHECKING:
    from shapefit.io.source import SourceFile


def numbers_of(names: Sequence[str]) -> list[int] | None:
    """Return landmark names as integers if all of them are numbers, else None."""
    numbers = [int(name) for name in names if name.isdecimal()]
    return numbers if names and len(numbers) == len(names) else None


def check_numbering(
    have: Sequence[str], want: Sequence[str], place: str, other: str
) -> tuple[str, ...]:
    """Return a warning if one list of names may count from 0, the other from 1, or ().

    `want` are the names in `other`, a dictionary, a truth or a skeleton. Raises
    InputError at `place` where they must be.
    """
    ours = numbers_of(have)
    theirs = numbers_of(want)
    if ours is None or theirs is None or (0 in ours) == (0 in theirs):
        return ()
    from_0, from_1 = (ours, theirs) if 0 in ours else (theirs, ours)
    ranges = (
        f"landmarks are numbered {min(ours)} to {max(ours)}, those of {other}"
        f" {min(theirs)} to {max(theirs)}"
    )
    whole = max(theirs) - min(theirs) + 1 == len(theirs)
    if whole and max(from_1) > max(from_0):
        fix = "count both from 0 or both from 1, by `rename: {1: 0, 2: 1}` and so on"
        raise input_error(place, ranges, fix)
    return (f"{ranges}: if one counts from 0 and one from 1, all are off by one",)


def match_landmarks(
    have: Sequence[str], want: Sequence[str], place: str = "landmark_names"
) -> NDArray[np.intp]:
    """Return i with have[i[j]] == want[j] for every j.

    Raises InputError at `place` with the nearest names for every wanted name that is
    not there.
    """
    index = {as_composed(name): number for number, name in enumerate(have)}
    want = [*map(as_composed, want)]
    absent = [name for name in want if name not in index]
    if len(absent) == len(want) > 1:
        none = f"none of the {len(want)} landmarks ({abbreviate(want, 10)}) is known"
        fix = "give files with the same landmark names"
        raise input_error(place, f"{none}; known are {abbreviate(have, 10)}", fix)
    if absent:
        problems = []
        for name in absent[:LIMIT]:
            near = " or ".join(f"'{other}'" for other in nearest_names(name, have))
            fix = (
                f"did you mean {near}?"
                if near
                else f"use one of: {abbreviate(have, 10)}"
            )
            problems.append(f"{place}: there is no landmark '{name}'; {fix}")
        raise input_problems(problems, len(absent))
    return np.array([index[name] for name in want], dtype=np.intp)


def nearest_names(name: str, names: Sequence[str]) -> list[str]:
    """Return up to three of `names`, those most similar to `name`."""
    from difflib import get_close_matches  # for messages alone

    return get_close_matches(name, names, n=3, cutoff=0.5)


def rename_landmarks(
    names: Sequence[str], rename: Mapping[str, str], place: str
) -> tuple[str, ...]:
    """Return landmark names after `rename` (old name -> new).

    Raises InputError at `place` where two landmarks would have one name.
    """
    first: dict[str, str] = {}
    rename = {as_composed(old): as_composed(new) for old, new in rename.items()}
    for before in names:
        after = rename.get(as_composed(before), before)
        if after in first:
            fault = (
                f"`rename` gives the name '{after}' to '{first[after]}' and '{before}'"
            )
            raise input_error(place, fault, "give every landmark a unique name")
        first[after] = before
    return tuple(first)


OTHER_SIDE = {"left": "right", "Left": "Right", "LEFT": "RIGHT", "l": "r", "L": "R"}
WORD_LEFT = re.compile(
    r"left|Left|LEFT|(?<![A-Za-z])[lL](?![a-z])|^[lL](?=[A-Za-z])|(?<=[a-z])L$"
)
"""`left` anywhere, `l` alone, before or behind a name: left_hip, HipLeft, L_Hip, LHip,
HipL.
"""


def find_side_pairs(names: Sequence[str]) -> list[tuple[int, int]]:
    """Return index pairs (left, right) of landmarks whose names differ only in side."""
    place = {name: number for number, name in enumerate(names)}
    pairs = {}
    for name, number in place.items():
        for word in WORD_LEFT.finditer(name):
            other = name[: word.start()] + OTHER_SIDE[word[0]] + name[word.end() :]
            if other in place:
                pairs[number] = place[other]
    return [*pairs.items()]


def prefix_with_file(
    files: Sequence[SourceFile[Record]],
) -> tuple[Sequence[SourceFile[Record]], tuple[str, ...]]:
    """Put file names before items if two files share one; return files and a note.

    Raises InputError for items that are twice in a file, and for files of one name.
    """
    shared = _find_shared_item(files)
    if shared is None:
        return files, ()
    paths = [Path(file.name).with_suffix("").parts for file in files]
    for depth in range(1, max(map(len, paths)) + 1):
        prefixes = ["/".join(parts[-depth:]) for parts in paths]
        if len({*prefixes}) == len(files):
            note = f"items begin with the file, '{prefixes[0]}/...'"
            named = [
                file.with_prefix(name)
                for file, name in zip(files, prefixes, strict=True)
            ]
            return named, (f"'{shared}' in more than one file: {note}",)
    fault = f"the item '{shared}' is in two files of this name"
    raise input_error(
        files[0].name, fault, "give each file once, under a name of its own"
    )


def _find_shared_item(files: Sequence[SourceFile[Record]]) -> str | None:
    """Return the name of an item that two files have, None where there is none.

    Raises InputError for items that are twice in a file. Only names whose hash is there
    twice are read again and compared: 8 bytes for each item.
    """
    if len(files) == 1 and files[0].has_unique_items:
        return None

    def item_names(file: SourceFile[Record]) -> Iterator[str]:
        """Yield the name of each item of a file."""
        return chain.from_iterable(file.blocks("item"))

    everything = chain.from_iterable(map(item_names, files))
    hashes = np.sort(np.fromiter(map(hash, everything), np.int64))
    again = set(hashes[1:][hashes[1:] == hashes[:-1]].tolist())
    first: dict[str, tuple[SourceFile[Record], int]] = {}
    shared, problems = None, []
    items = (
        (file, row, name) for file in files for row, name in enumerate(item_names(file))
    )
    for file, row, name in items if again else ():
        if hash(name) not in again:
            continue
        other, before = first.get(name, (None, 0))
        if other is file:
            where = f"item '{name}' is also at {file.place('item', before)}"
            problems.append(
                f"{file.place('item', row)}: {where}; give every item a unique name"
            )
        elif other is not None:
            shared = shared or name
        first[name] = file, row
    if problems:
        raise input_problems(problems)
    return shared
