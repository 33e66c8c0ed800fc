"""Names of landmarks: those that are wanted found among those that a file has, and renamed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from difflib import get_close_matches

import numpy as np
from numpy.typing import NDArray

from shapefit.errors import abbreviate, input_error
from shapefit.io.problems import LIMIT, input_problems

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
