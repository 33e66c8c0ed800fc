"""Records that a program gives in place of files: the same checks, the same errors."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import nullcontext
from dataclasses import replace
from typing import Any

import numpy as np

from shapefit.dictionary.model import Dictionary
from shapefit.io.duplicates import ItemList, check_unique_items
from shapefit.io.kinds.dictionaries import check_dictionary
from shapefit.io.kinds.landmarks import LandmarkSource, one_file
from shapefit.io.layout import DICTIONARY, LANDMARKS, SHAPES, Format
from shapefit.io.records import LandmarkSet, ShapeSet
from shapefit.io.renaming import check_known, renamed
from shapefit.io.stored import checks


class Given:
    """Datasets in memory, with what the checks ask an open file for."""

    def __init__(self, name: str, record: Any, form: Format) -> None:
        self._name = name
        self._values: Mapping[str, Any] = {
            dataset.name: getattr(record, dataset.attribute) for dataset in form.datasets
        }
        self._sizes = {
            axis: size
            for dataset in form.datasets
            if (value := self._values[dataset.name]) is not None
            for axis, size in zip(
                dataset.memory_axes,
                (len(value),) if dataset.kind == "text" else value.shape,
                strict=True,
            )
        }
        self.landmark_names: tuple[str, ...] = record.landmark_names

    def has(self, name: str) -> bool:
        """Whether there is such a dataset."""
        return self._values[name] is not None

    def size(self, axis: str) -> int | None:
        """Length of an axis of the format; None if nothing has it."""
        return self._sizes.get(axis)

    def place(self, name: str, row: int | None = None) -> str:
        """Name a dataset, or a row of it, in messages."""
        whole = self._name if name == self._name else f"{self._name}.{name}"
        return whole + ("" if row is None else f"[{row}]")

    def read(self, name: str) -> Any:
        """Return a dataset; None if there is none."""
        return self._values[name]

    def is_written(self, name: str) -> bool:
        """Whether the dataset has values: in memory all have."""
        return True


def given_landmarks(landmarks: LandmarkSet, name: str, rename: Mapping[str, str]) -> LandmarkSource:
    """Return landmarks in memory as a source; `name` stands for its file in messages.

    Raises InputError as `open_landmarks` does for what a file holds.
    """
    given = Given(name, landmarks, LANDMARKS)
    checks.check_named(given, [landmarks.items])
    checks.check_not_infinite(given, "landmarks", [landmarks.landmarks])
    if landmarks.confidence is not None:
        checks.check_confidence(given, [landmarks.confidence])
    check_known(rename, [(name, landmarks.landmark_names)])
    landmarks = renamed(landmarks, rename, name)
    items = ItemList(lambda: [landmarks.items], lambda row: given.place("item", row))
    read = nullcontext(landmarks.take)
    file = one_file(name, landmarks, items, lambda: read, landmarks.y_axis)
    return LandmarkSource([file], landmarks.y_axis)


def given_shapes(
    shapes: ShapeSet, name: str, rename: Mapping[str, str], *, gaps: bool = False
) -> ShapeSet:
    """Return shapes in memory as `read_shapes` gives them, and with its errors."""
    given = Given(name, shapes, SHAPES)
    checks.check_named(given, [shapes.items])
    check_points = checks.check_finite_or_gap if gaps else checks.check_finite
    check_points(given, "shapes", [shapes.shapes])
    if shapes.mesh_vertices is not None:
        checks.check_finite(given, "mesh_vertices", [shapes.mesh_vertices])
    checks.check_indices(given, "edges", "p")
    checks.check_indices(given, "mesh_faces", "q")
    items = ItemList(lambda: [shapes.items], lambda row: given.place("item", row))
    check_unique_items([items])
    check_known(rename, [(name, shapes.landmark_names)])
    unknown = np.isnan(shapes.shapes).any(axis=1, keepdims=True)
    points = np.where(unknown, np.nan, shapes.shapes)
    return renamed(replace(shapes, shapes=points), rename, name)


def check_given_dictionary(dictionary: Dictionary, name: str) -> None:
    """Raise InputError for what `read_dictionary` would not read from a file."""
    check_dictionary(Given(name, dictionary, DICTIONARY))
