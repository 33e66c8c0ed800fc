"""Items: what landmarks, shapes and fits have in common."""

# No `from __future__ import annotations` here: `columns_of` reads what stands beside
# the fields.

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Annotated, ClassVar, Literal, Self, TypeVar

import numpy as np

from shapefit.arrays import Floats, Integers
from shapefit.errors import counted, input_error
from shapefit.records.columns import (
    Array,
    Named,
    Rows,
    Texts,
    Unit,
    column_by_name,
    complete,
    in_columns,
    present_columns,
    take_rows,
)
from shapefit.records.names import all_composed

UNKNOWN_UNIT = "unknown"

Attribute = str | float | int
Direction = Literal["up", "down"]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class Items:
    """n items of p landmarks. A slice or a mask gives some of them, a number one.

    Landmarks and items without names have (): `named` gives them some.
    """

    POINTS: ClassVar[str] = ""
    """The field that every record of a class has."""

    landmark_names: Annotated[Texts, "p"] = ()
    """Names of the landmarks, all different."""
    items: Annotated[Texts, "n", Named("item")] = ()
    """Names of the items, all different."""
    sequences: Annotated[Texts | None, "n", Named("sequence")] = None
    """Video of each item."""
    frames: Annotated[Integers | None, "n", Named("frame")] = None
    """Place in its video, from 0; gaps are gaps."""
    times: Annotated[Floats | None, "n", Unit("s"), Named("time")] = None
    """Time in its video as the file states it, NaN where it does not."""
    edges: Annotated[Integers | None, "e 2"] = None
    """Landmarks that a line joins, by position."""
    unit: str = UNKNOWN_UNIT
    """Unit of lengths."""
    frame_rate: float | None = None
    """Images in a second."""
    y_axis: Direction | None = None
    """Where y points; None for shapes."""
    extras: Mapping[str, Array] = field(default_factory=dict)
    """Columns that no field lists, a row an item."""
    file_extras: Mapping[str, Array] = field(default_factory=dict)
    """Datasets that no field lists, of the whole file."""
    attributes: Mapping[str, Attribute] = field(default_factory=dict)
    """What is stored with the file, such as how it was made."""

    def __post_init__(self) -> None:
        """Convert the fields to their types; InputError where one does not fit."""
        complete(self)
        set_field = object.__setattr__
        set_field(self, "landmark_names", all_composed(self.landmark_names))
        listed = column_by_name(type(self))
        for name in (*self.extras, *self.file_extras):
            if name in listed:
                fix = f"give it as `{listed[name].field}`"
                raise input_error(f"extras.{name}", "is a field of its own", fix)
        extras = {name: np.asarray(value) for name, value in self.extras.items()}
        for name, values in extras.items():
            if values.shape[:1] != (len(self),):
                fault = f"has the shape {values.shape}, not a row for each of"
                fault += f" {counted(len(self), 'item')}"
                fix = "give what belongs to all of them as `file_extras`"
                raise input_error(f"extras.{name}", fault, fix)
        set_field(self, "extras", extras)
        whole = {name: np.asarray(value) for name, value in self.file_extras.items()}
        set_field(self, "file_extras", whole)

    @property
    def points(self) -> Floats:
        """The landmarks (n, p, 2), or the shapes (n, p, 3)."""
        points: Floats = getattr(self, self.POINTS)
        return points

    def __len__(self) -> int:
        return len(self.points)

    def __getitem__(self, rows: int | Rows) -> Self:
        """Return some items as a record; an integer gives a record of one item."""
        return self.take(np.atleast_1d(np.arange(len(self))[rows]))

    def __repr__(self) -> str:
        landmarks = counted(self.points.shape[1], "landmark")
        items = counted(len(self), "item")
        return f"<shapefit.{type(self).__name__}: {items}, {landmarks}, in {self.unit}>"

    def take(self, rows: Rows) -> Self:
        """Return some items, in the order of `rows`; a slice copies nothing."""
        if not isinstance(rows, slice):
            rows = np.arange(len(self))[rows]
        elif rows.indices(len(self)) == (0, len(self), 1):
            return self
        return replace(self, **take_rows(self, rows))  # type: ignore[arg-type]

    def replaced(self, **changes: object) -> Self:
        """Return the record with these fields changed; None takes a field out."""
        return replace(self, **changes) if changes else self  # type: ignore[arg-type]

    def as_columns(self) -> Floats:
        """Return the points as (n, d, p), one landmark a column, see `in_columns`."""
        return in_columns(self.points)

    def with_points(self, points: Floats) -> Self:
        """Return the record with other points (n, p, d)."""
        changes = {self.POINTS: points}
        return replace(self, **changes)  # type: ignore[arg-type]

    def with_whole_points(self) -> Self:
        """Return the record with points all nan where one of their coordinates is."""
        unknown = np.isnan(self.points)
        if not unknown.any():
            return self
        partly = unknown.any(axis=2, keepdims=True)
        return self.with_points(np.where(partly, np.nan, self.points))

    def named(self, landmark_names: Sequence[str] = ()) -> Self:
        """Return the record with names for landmarks and items that have none.

        Landmarks get the given ones, by default their numbers; items get theirs.
        """
        n, p = self.points.shape[:2]
        names = self.landmark_names or landmark_names or tuple(map(str, range(p)))
        items = self.items or tuple(map(str, range(n)))
        return replace(self, landmark_names=names, items=items)

    @property
    def lines(self) -> Integers | None:
        """Return the edges (l, 2) between landmarks that the record has, else None."""
        if self.edges is None:
            return None
        count = len(self.landmark_names)
        return self.edges[((self.edges >= 0) & (self.edges < count)).all(axis=1)]

    def column(self, name: str) -> Array | None:
        """Return a column or an extra dataset by its name in files; None without it."""
        listed = column_by_name(type(self)).get(name)
        if listed is not None:
            value = getattr(self, listed.field)
            return None if value is None else np.asarray(value)
        return self.extras.get(name, self.file_extras.get(name))

    def item_columns(self) -> dict[str, Array]:
        """Return the columns that have a row for each item, by their names in files.

        But for the names of items and sequences.
        """
        columns = {
            column.name: np.asarray(value)
            for column, value in present_columns(self)
            if column.axes[0] == "n" and column.kind != Texts
        }
        return columns | dict(self.extras)

    def column_names(self) -> set[str]:
        """Return the names in files of all columns and extra datasets there are."""
        return {
            *(column.name for column, _ in present_columns(self)),
            *self.extras,
            *self.file_extras,
        }

    def with_extras(self, extras: Mapping[str, Array]) -> Self:
        """Return the record with more columns, a row for each item.

        They replace extra ones of the same names.
        """
        whole = {name: v for name, v in self.file_extras.items() if name not in extras}
        return replace(self, extras={**self.extras, **extras}, file_extras=whole)

    def with_file_extras(self, extras: Mapping[str, Array]) -> Self:
        """Return the record with more datasets of the whole file.

        They replace extra ones of the same names.
        """
        rows = {name: v for name, v in self.extras.items() if name not in extras}
        return replace(self, extras=rows, file_extras={**self.file_extras, **extras})

    def without(self, names: Collection[str]) -> Self:
        """Return the record without the columns and extra datasets of these names."""
        changes: dict[str, object] = {
            column.field: None
            for column, _ in present_columns(self)
            if column.name in names
        }
        for kind in ("extras", "file_extras"):
            values = getattr(self, kind).items()
            changes[kind] = {name: v for name, v in values if name not in names}
        return replace(self, **changes)  # type: ignore[arg-type]


Record = TypeVar("Record", bound=Items)


def concatenate(parts: Sequence[Record]) -> Record:
    """Join records of the same landmarks and columns, one after the other.

    What belongs to the whole file comes from the first.
    """
    first = parts[0]
    if len(parts) == 1:
        return first
    changes: dict[str, object] = {}
    for column, value in present_columns(first):
        if not column.per_item:
            continue
        values = [getattr(part, column.field) for part in parts]
        if isinstance(value, np.ndarray):
            changes[column.field] = np.concatenate(values)
        else:
            names: list[str] = []
            for part in values:
                names += part or ()
            changes[column.field] = tuple(names)
    changes["extras"] = {
        name: np.concatenate([part.extras[name] for part in parts])
        for name in first.extras
    }
    return replace(first, **changes)  # type: ignore[arg-type]
