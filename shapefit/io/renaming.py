"""Names of landmarks as a file has them, turned into those that it is matched by."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TypeVar

from shapefit.errors import abbreviate, input_error
from shapefit.io.records import LandmarkSet, ShapeSet, nearest_names

Record = TypeVar("Record", ShapeSet, LandmarkSet)

KEY = "rename"


def renamed(records: Record, rename: Mapping[str, str], place: str) -> Record:
    """Return the records with the landmarks that `rename` (old name -> new) knows renamed.

    Raises InputError at `place` where two landmarks would have one name.
    """
    if not rename:
        return records
    old = records.landmark_names
    new = tuple(rename.get(name, name) for name in old)
    first: dict[str, str] = {}
    for before, after in zip(old, new, strict=True):
        if after in first:
            found = f"`{KEY}` gives the name '{after}' to '{first[after]}' and '{before}'"
            raise input_error(place, found, "give every landmark a unique name")
        first[after] = before
    return replace(records, landmark_names=new)


def check_known(rename: Mapping[str, str], files: Sequence[tuple[str, Sequence[str]]]) -> None:
    """Raise InputError where `rename` names landmarks that no file (name, landmarks) has."""
    known = list(dict.fromkeys(name for _, names in files for name in names))
    unknown = [name for name in rename if name not in set(known)]
    if not unknown:
        return
    near = {name: nearest_names(name, known) for name in unknown}
    hints = [
        f"'{name}' -> {' or '.join(map(repr, close))}" for name, close in near.items() if close
    ]
    found = f"{', '.join(place for place, _ in files)}: no landmark {abbreviate(unknown)}"
    meant = f"did you mean {', '.join(hints)}?" if hints else f"there are {abbreviate(known)}"
    raise input_error(KEY, found, meant)
