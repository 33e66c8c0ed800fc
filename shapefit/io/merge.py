"""Whether several files go together, and what their items have in common."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import Any

import numpy as np

from shapefit.errors import input_error
from shapefit.io.layout import EDGES, TIME, UNKNOWN_UNIT
from shapefit.io.options import Direction
from shapefit.io.records import LandmarkSet, ResultSet

SEPARATELY = "use files that agree, or process them separately"
CONFIDENCE = "confidence"

IN_SOME_FILES = (CONFIDENCE, TIME)
"""Columns that files of one source need not all have."""


def merge_heads(files: Sequence[Any], y_axis: Direction | None) -> Any:
    """Return what all items of files have in common: one head for all.

    The landmarks of images are those of all files in order of appearance, those of
    shapes and of results are the same in all. What differs between files of images, as
    cameras do, is of items. Confidence, times and edges may be in some files alone; the
    edges are those of the first that has any. Raises InputError where files do not go
    together, or state another direction than `y_axis`.
    """
    heads = [file.head for file in files]
    names, differing = heads[0].landmark_names, set[str]()
    places = [file.name for file in files]
    if isinstance(heads[0], ResultSet):
        _agreed(
            "list of landmarks",
            places,
            [", ".join(head.landmark_names) for head in heads],
        )
    if isinstance(heads[0], LandmarkSet):
        names = tuple(
            dict.fromkeys(name for head in heads for name in head.landmark_names)
        )
        differing = {
            n for n in heads[0].whole if not all(_agree(heads[0], h, n) for h in heads)
        }
    heads = [
        _per_item(head, differing - {EDGES}).arrange(names, file.name)
        for file, head in zip(files, heads, strict=True)
    ]
    for file, head in zip(files, heads, strict=True):
        for name in sorted(
            (head.columns.keys() | heads[0].columns.keys()) - {*IN_SOME_FILES, EDGES}
        ):
            if not _agree(heads[0], head, name):
                fault = f"its dataset {name} is not that of {files[0].name}"
                raise input_error(file.name, fault, SEPARATELY)
    units = [None if head.unit == UNKNOWN_UNIT else head.unit for head in heads]
    stated = [*(file.y_axis for file in files), y_axis]
    columns = {name: values for head in heads for name, values in head.per_item.items()}
    whole = {
        name: values for head in reversed(heads) for name, values in head.whole.items()
    }
    return (
        heads[0]
        .with_columns(columns, whole)
        .replaced(
            unit=_agreed("unit", places, units) or UNKNOWN_UNIT,
            frame_rate=_agreed(
                "frame_rate", places, [head.frame_rate for head in heads]
            ),
            y_axis=_agreed("y_axis", [*places, "y_axis"], stated) or "down",
            sequences=next(
                (head.sequences for head in heads if head.sequences is not None), None
            ),
        )
    )


def align_to(part: Any, head: Any, file: str) -> Any:
    """Return a part of one file with the landmarks and columns of the whole source."""
    part = _per_item(part, head.per_item)
    if CONFIDENCE in head.per_item and CONFIDENCE not in part.per_item:
        part = part.with_columns(
            {CONFIDENCE: np.ones((len(part), len(part.landmark_names)))}
        )
    if TIME in head.per_item and TIME not in part.per_item:
        part = part.with_columns({TIME: np.full(len(part), np.nan)})
    missing = head.sequences is not None and part.sequences is None
    part = part.arrange(head.landmark_names, file).replaced(
        sequences=("",) * len(part) if missing else part.sequences,
        unit=head.unit,
        frame_rate=head.frame_rate,
        y_axis=head.y_axis,
        attributes=head.attributes,
    )
    return (
        part.with_columns(whole={EDGES: head.whole[EDGES]})
        if EDGES in head.whole
        else part
    )


def _per_item(records: Any, names: Collection[str]) -> Any:
    """Return records in which these columns of the file are columns of each item."""
    n, values = len(records), {k: v for k, v in records.whole.items() if k in names}
    columns = {
        name: np.broadcast_to(value, (n, *value.shape))
        for name, value in values.items()
    }
    return records.with_columns(columns) if columns else records


def _agree(first: Any, head: Any, name: str) -> bool:
    """Whether heads, without items, have the same column: of items, rows of one
    shape.
    """
    one, other = first.columns.get(name), head.columns.get(name)
    if one is None or other is None or (name in first.whole) != (name in head.whole):
        return False
    return np.array_equal(
        one, other, equal_nan=one.dtype.kind == other.dtype.kind == "f"
    )


def _agreed(what: str, places: Sequence[str], stated: Sequence[Any]) -> Any:
    """Return what all places state, None if none does. Raises InputError where two
    differ.
    """
    place_of = {
        v: place for place, v in zip(places, stated, strict=True) if v is not None
    }
    first, *others = place_of or (None,)
    for value in others:
        fault = f"its {what} is '{value}', that of {place_of[first]} is '{first}'"
        raise input_error(place_of[value], fault, SEPARATELY)
    return first
