"""Whether several files go together, and what their items have in common."""

from __future__ import annotations

from collections.abc import Collection, Hashable, Sequence
from dataclasses import replace
from itertools import chain
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from shapefit.errors import abbreviate, counted, input_error
from shapefit.io.arrange import arrange
from shapefit.io.layout import EDGES, FRAME, TIME, UNKNOWN_UNIT
from shapefit.io.names import check_numbering, numbers_of
from shapefit.records.columns import Array, present_columns
from shapefit.records.fit import Fit
from shapefit.records.items import Direction, Items, Record
from shapefit.records.landmarks import Landmarks
from shapefit.records.shapes import Shapes

if TYPE_CHECKING:
    from shapefit.io.source import SourceFile

Stated = TypeVar("Stated", bound=Hashable)

SEPARATELY = "use files that agree, or process them separately"

IN_SOME_FILES = ("confidence", TIME, EDGES)
"""Columns that files of one source need not all have."""


def merge_heads(
    files: Sequence[SourceFile[Record]], y_axis: Direction | None
) -> Record:
    """Merge heads of files (records without rows) into one; check that they agree.

    The landmarks of images are those of all files in order of appearance, those of
    shapes and of results are the same in all. What differs between files of images, as
    cameras do, becomes a column of items. Confidence, times and edges may be in some
    files alone, and frames where the others have no sequences; the edges are those of
    the first that has any. Raises InputError where files do not go together, or state
    another direction than `y_axis`.
    """
    heads = [file.head for file in files]
    first = heads[0]
    places = [file.name for file in files]
    names = first.landmark_names
    differing: set[str] = set()
    if isinstance(first, Fit):
        lists = [", ".join(head.landmark_names) for head in heads]
        _common_value("list of landmarks", places, lists)
    if isinstance(first, Shapes):
        for place, head in zip(places[1:], heads[1:], strict=True):
            _check_same_landmarks((places[0], names), (place, head.landmark_names))
    if isinstance(first, Landmarks):
        for place, head in zip(places[1:], heads[1:], strict=True):
            check_numbering(head.landmark_names, names, place, places[0])
        every = chain.from_iterable(head.landmark_names for head in heads)
        names = tuple(dict.fromkeys(every))
        differing = {
            name
            for name in first.file_extras
            if not all(_have_same_column(first, head, name) for head in heads)
        }
    heads = [
        arrange(_repeat_per_item(head, differing), names, file.name)
        for file, head in zip(files, heads, strict=True)
    ]
    _check_columns(places, heads)
    units = [None if head.unit == UNKNOWN_UNIT else head.unit for head in heads]
    stated = [*(file.y_axis for file in files), y_axis]
    changes = _join_columns(heads)
    changes["unit"] = _common_value("unit", places, units) or UNKNOWN_UNIT
    rates = [head.frame_rate for head in heads]
    changes["frame_rate"] = _common_value("frame_rate", places, rates)
    direction = _common_value("y_axis", [*places, "y_axis"], stated)
    if not isinstance(first, Shapes):
        changes["y_axis"] = direction or "down"
    return heads[0].replaced(**changes)


def _check_columns(places: Sequence[str], heads: Sequence[Items]) -> None:
    """Raise InputError for a column that is not in all files, or not as in the first.

    Columns that may be in some files alone are not checked.
    """
    optional = {*IN_SOME_FILES, "landmark_names", "item", "sequence"}
    without_frames = [head for head in heads if head.frames is None]
    if all(head.sequences is None for head in without_frames):
        optional.add(FRAME)
    for place, head in zip(places, heads, strict=True):
        for name in sorted((head.column_names() | heads[0].column_names()) - optional):
            if not _have_same_column(heads[0], head, name):
                fault = f"its dataset {name} is not that of {places[0]}"
                raise input_error(place, fault, SEPARATELY)


def _join_columns(heads: Sequence[Items]) -> dict[str, object]:
    """Return field -> value for all columns that any head has, extras among them.

    What is not per item is that of the first head that has it.
    """
    changes: dict[str, object] = {}
    extras: dict[str, Array] = {}
    file_extras: dict[str, Array] = {}
    for head in reversed(heads):
        for column, value in present_columns(head):
            changes[column.field] = value
        file_extras |= head.file_extras
    for head in heads:
        extras |= head.extras
    changes["extras"] = extras
    changes["file_extras"] = file_extras
    return changes


def _check_same_landmarks(*files: tuple[str, Sequence[str]]) -> None:
    """Raise InputError unless two (file, landmark names) have the same landmarks."""
    (_, first), (_, second) = files
    common = [name for name in first if name in set(second)]
    for (place, names), (other, others) in (files, files[::-1]):
        absent = [name for name in others if name not in set(names)]
        if not absent:
            continue
        fault = f"has no landmark '{absent[0]}', which {other} has"
        if len(absent) > 1:
            fault = f"lacks {counted(len(absent), 'landmark')} of {other}"
            fault += f" ({abbreviate(absent)})"
        fix = "give shapes of the same landmarks"
        if numbers_of(first) and numbers_of(second):
            fix += ", all numbered from 0 or all from 1"
        elif common:
            shown = abbreviate(common, 3)
            fix += f", or name those that all have by `landmarks` ({shown})"
        raise input_error(place, fault, fix)


def align_to(part: Record, head: Record, file: str) -> Record:
    """Return rows of one file with the landmarks and columns of a source's head."""
    n = len(part)
    part = _repeat_per_item(part, head.extras)
    changes: dict[str, object] = {}
    if _lacks_confidence(part, head):
        ones = np.ones(part.points.shape[:2])
        if isinstance(part, Landmarks):
            changes["confidence"] = ones
        else:
            changes["extras"] = {**part.extras, "confidence": ones}
    if head.times is not None and part.times is None:
        changes["times"] = np.full(n, np.nan)
    if head.frames is not None and part.frames is None:
        changes["frames"] = np.zeros(n, np.int64)
    if head.sequences is not None and part.sequences is None:
        changes["sequences"] = ("",) * n
    if head.y_axis is not None:
        changes["y_axis"] = head.y_axis
    part = part.replaced(
        unit=head.unit,
        frame_rate=head.frame_rate,
        attributes=head.attributes,
        **changes,
    )
    part = arrange(part, head.landmark_names, file)
    return part if head.edges is None else replace(part, edges=head.edges)


def _lacks_confidence(part: Items, head: Items) -> bool:
    """Whether a source has confidences, by its head, and a part of a file has none."""
    wanted = head.column("confidence") is not None
    return wanted and part.column("confidence") is None


def _repeat_per_item(record: Record, names: Collection[str]) -> Record:
    """Turn file extras `names` into extras, each value repeated for every item."""
    extras = {
        name: np.broadcast_to(value, (len(record), *value.shape))
        for name, value in record.file_extras.items()
        if name in names
    }
    return record.with_extras(extras) if extras else record


def _have_same_column(first: Items, head: Items, name: str) -> bool:
    """Whether two heads (records without rows) have an equal column of this name.

    Of columns with a row for each item, that is the shape of rows.
    """
    one = first.column(name)
    other = head.column(name)
    if one is None or other is None:
        return False
    if (name in first.file_extras) != (name in head.file_extras):
        return False
    both_floats = one.dtype.kind == other.dtype.kind == "f"
    return np.array_equal(one, other, equal_nan=both_floats)


def _common_value(
    name: str, places: Sequence[str], values: Sequence[Stated | None]
) -> Stated | None:
    """Return the value that files state, None if none does; InputError if two differ.

    `places` name the files, `name` the value in the message.
    """
    place_of = {
        v: place for place, v in zip(places, values, strict=True) if v is not None
    }
    if not place_of:
        return None
    first, *others = place_of
    for value in others:
        fault = f"its {name} is '{value}', that of {place_of[first]} is '{first}'"
        raise input_error(place_of[value], fault, SEPARATELY)
    return first
