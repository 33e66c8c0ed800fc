"""Landmarks by name: records with the landmarks that are asked for, in their order."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Integers
from shapefit.io.layout import LABELS
from shapefit.io.names import match_landmarks
from shapefit.records.columns import Array
from shapefit.records.items import Items, Record
from shapefit.records.landmarks import Landmarks
from shapefit.records.shapes import Shapes

Scalar = TypeVar("Scalar", bound=np.generic)

PER_LANDMARK = ("confidence", *LABELS)
"""Names of extra columns (n, p) with a value for each landmark of each item."""


def arrange(
    record: Record,
    names: Sequence[str],
    place: str = "landmark_names",
    *,
    omit: bool = False,
) -> Record:
    """Select and reorder a record's landmarks by name; add those that images lack.

    Landmarks that images lack are unseen (NaN, confidence 0) and have no label; edges
    move with their landmarks. Landmarks that `names` lacks are left out with `omit`.
    Raises InputError at `place` for those otherwise, and for shapes that lack one.
    """
    names = tuple(names)
    before = record.landmark_names
    if names == before:
        return record
    if not omit:
        match_landmarks(names, before, place)
    if isinstance(record, Shapes):
        match_landmarks(before, names, place)
    p = len(before)
    place_of = {name: column for column, name in enumerate(before)}
    unseen = p  # the row of a landmark that is added behind the others
    rows = np.array([place_of.get(name, unseen) for name in names], np.intp)
    new_index = np.full(p + 1, -1)
    new_index[rows] = np.arange(len(names))

    padded = np.pad(record.points, [(0, 0), (0, 1), (0, 0)], constant_values=np.nan)
    changes: dict[str, object] = {
        "landmark_names": names,
        record.POINTS: padded[:, rows],
        "extras": {
            name: _take_padded(values, rows)
            if _is_per_landmark(record, name, values)
            else values
            for name, values in record.extras.items()
        },
    }
    if isinstance(record, Landmarks) and record.confidence is not None:
        changes["confidence"] = _take_padded(record.confidence, rows)
    if record.lines is not None:
        changes["edges"] = _move_edges(record.lines, new_index)
    if isinstance(record, Shapes) and record.mirror_index is not None:
        partners = record.mirror_index[rows]
        changes["mirror_index"] = new_index.take(partners, mode="clip")
    return record.replaced(**changes)


def _is_per_landmark(record: Items, name: str, values: Array) -> bool:
    """Whether an extra column is known to have a value per item and landmark (n, p)."""
    shape = (len(record), len(record.landmark_names))
    return name in PER_LANDMARK and values.shape[:2] == shape


def _take_padded(values: NDArray[Scalar], columns: NDArray[np.intp]) -> NDArray[Scalar]:
    """Return values (n, p) at `columns` from 0 to p, where column p is all zeros."""
    return np.pad(values, [(0, 0), (0, 1)])[:, columns]


def _move_edges(edges: Integers, new_index: NDArray[np.intp]) -> Integers:
    """Renumber edges (e, 2) by `new_index`; drop those of removed landmarks (-1)."""
    moved = new_index[edges]
    return moved[(moved >= 0).all(axis=1)]
