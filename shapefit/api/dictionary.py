"""A dictionary with one landmark per row, as in files."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np

from shapefit.dictionary import model
from shapefit.errors import input_error
from shapefit.io.layout import DICTIONARY, DICTIONARY_POINTS
from shapefit.records.columns import Column, as_kind, fit_axes
from shapefit.records.items import UNKNOWN_UNIT
from shapefit.records.names import all_composed


@dataclass(frozen=True, repr=False, eq=False)
class Dictionary:
    """k atoms: atoms (k, p, 3), centred and on the scale of normalised shapes.

    landmark_names are by default 0, 1, ..., mean_shape (p, 3) is the mean of the atoms.
    prior is the mixture over shapes that `learn` or `read_dictionary` gives, learned
    what was learned besides (docs/files.md), provenance how it was made.
    """

    atoms: Any
    landmark_names: Sequence[str] | None = None
    mean_shape: Any = None
    edges: Any = None
    mesh_vertices: Any = None
    mesh_faces: Any = None
    atom_scale: Any = None
    atom_items: Sequence[str] | None = None
    unit: str = UNKNOWN_UNIT
    prior: Any = None
    learned: Mapping[str, Any] = field(default_factory=dict)
    provenance: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        values = _checked(vars(self))
        if values["landmark_names"] is None:
            values["landmark_names"] = tuple(map(str, range(values["atoms"].shape[1])))
        if values["mean_shape"] is None:
            values["mean_shape"] = values["atoms"].mean(axis=0)
        self.__dict__.update(values)

    @classmethod
    def of(cls, dictionary: model.Dictionary) -> Dictionary:
        """Return the internal `model.Dictionary` as one with a landmark per row."""
        values = {
            field.name: getattr(dictionary, field.name) for field in fields(dictionary)
        }
        learned = _transposed(values)
        names = {field.name for field in fields(cls)}
        return cls(
            **{name: learned.pop(name) for name in names & learned.keys()},
            learned=learned,
        )

    def model(self) -> model.Dictionary:
        """Return the internal `model.Dictionary`, with one landmark per column."""
        values = {
            name: value for name, value in vars(self).items() if name != "learned"
        }
        values["landmark_names"] = all_composed(self.landmark_names or ())
        return model.Dictionary(**_transposed(values), **self.learned)

    def replaced(self, **changes: Any) -> Dictionary:
        """Return the same with other fields."""
        return replace(self, **changes)


def _transposed(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return fields with landmarks in rows instead of columns, or vice versa."""
    turned = dict(values)
    for name in DICTIONARY_POINTS:
        if turned.get(name) is not None:
            turned[name] = np.ascontiguousarray(np.swapaxes(turned[name], -1, -2))
    return turned


def _checked(given: Mapping[str, Any]) -> dict[str, Any]:
    """Return the fields of a dictionary as arrays, and names as tuples.

    Raises InputError for arrays that are no numbers or whose axes disagree.
    """
    values = dict(given)
    sizes: dict[str, int] = {}
    # The atoms say how many landmarks there are, and the rest must agree.
    columns = sorted(
        DICTIONARY.columns.values(), key=lambda one: one.name not in DICTIONARY_POINTS
    )
    for column in columns:
        if values.get(column.field) is not None:
            values[column.field] = _checked_column(column, values[column.field], sizes)
    return values


def _checked_column(column: Column, value: object, sizes: dict[str, int]) -> Any:
    """Return a field in the type of its column, and add its axes to `sizes`.

    Raises InputError as `_checked`.
    """
    place = f"dictionary.{column.field}"
    try:
        converted = as_kind(column, value)
    except (TypeError, ValueError):
        raise input_error(place, "is no array of numbers", "give numbers") from None
    shape = np.shape(converted)
    expected = tuple(sizes.get(str(axis), axis) for axis in column.axes)
    if not fit_axes(column.axes, shape, sizes):
        row = ", one landmark per row" if column.name in DICTIONARY_POINTS else ""
        fix = f"it must be {expected}".replace("'", "") + row
        raise input_error(place, f"has the shape {shape}", fix)
    return converted
