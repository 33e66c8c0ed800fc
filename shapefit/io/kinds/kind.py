"""The kind of a file: landmarks, shapes, result or dictionary."""

from __future__ import annotations

from pathlib import Path
from typing import Literal, get_args

from shapefit.errors import input_error
from shapefit.io.foreign.opening import open_either
from shapefit.io.formats import CSV, find_format
from shapefit.io.options import AS_THEY_ARE, InputOptions
from shapefit.io.sources import is_stream
from shapefit.io.stored.opening import stored_form

Kind = Literal["landmarks", "shapes", "result", "dictionary"]

LONGEST_HEADER = 1 << 16
"""Characters of a first line that are looked at: a device may never end it."""


def find_kind(path: Path, options: InputOptions = AS_THEY_ARE) -> Kind:
    """Return what a file holds. A table with the column z holds shapes.

    Raises InputError for what is wrong with the file, and for standard input, which could not be
    read again.
    """
    if is_stream(path):
        found = "standard input can be read only once"
        raise input_error("-", found, "save it to a file and name that")
    known = find_format(path, options.format)
    if known.recorder is not None:
        if len(known.records) == 1:  # JSON, for one, would be read whole to say so
            return known.records[0]  # type: ignore[return-value]
        recording = open_either(known, (path,))
        return "landmarks" if recording.dimensions == 2 else "shapes"
    if known.form is not None:
        return stored_form(path).kind  # type: ignore[return-value]
    if known is CSV:
        return "shapes" if has_depth(path) else "landmarks"
    kinds: tuple[Kind, ...] = get_args(Kind)
    return next(kind for kind in kinds if kind in known.readers)


def has_depth(path: Path) -> bool:
    """Whether a table has the column z."""
    with path.open(encoding="utf-8", errors="replace") as file:
        columns = file.readline(LONGEST_HEADER).lstrip("\ufeff").strip().split(",")
    return "z" in {column.strip(' "') for column in columns}
