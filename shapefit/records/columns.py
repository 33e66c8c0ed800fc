"""What a field of a record is, said once beside it, and what follows from that.

    shapes: Annotated[Floats, "n p 3", LENGTH]

says type, axes and unit. Layouts of files, conversions, checks, rows and the tables of
the documentation are made of it. Letters of axes are sizes that agree over a record: n
items, p landmarks, k atoms, e edges, q vertices and f faces of a mesh, r coordinates of
all landmarks, i landmarks of a detector; a counts the transforms that are not 0, one
image after the other.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from inspect import get_annotations
from types import UnionType
from typing import TYPE_CHECKING, NamedTuple, get_args

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Flags, Floats, Integers
from shapefit.errors import input_error

if TYPE_CHECKING:
    from shapefit.records.items import Items

Singles = NDArray[np.float32]
"""Numbers of which few digits count; files may have more."""

Words = NDArray[np.object_]
"""Texts of items, as an array, so that they can be compared."""

Texts = Sequence[str]
"""Names; whatever sequence is given, records hold a tuple."""

Array = NDArray[np.generic]

COUNTS = "transform_count"
"""The field, and the dataset, that says how many rows of axis a belong to each item."""

Rows = slice | NDArray[np.integer] | Flags | Sequence[int]


class Unit(NamedTuple):
    """The unit of a column."""

    text: str


class Named(NamedTuple):
    """The name of a column in files, where its field has another."""

    text: str


LENGTH = Unit("unit of the record")


class Column(NamedTuple):
    """A column as files and checks know it.

    axes are letters or numbers; kind is that of the arrays, or Texts.
    """

    field: str
    name: str
    axes: tuple[str | int, ...]
    kind: object
    unit: str = ""
    required: bool = False

    @property
    def per_item(self) -> bool:
        """Whether the column has rows for each item, rather than one value for all."""
        return self.axes[0] in ("n", "a")

    @property
    def has_points(self) -> bool:
        """Whether the column holds points, one landmark a row: (n, p, d)."""
        return self.axes[:2] in (("n", "p"), ("n", "i")) and len(self.axes) == 3

    @property
    def is_text(self) -> bool:
        """Whether the column holds texts."""
        return self.kind in (Texts, Words)

    @property
    def noun(self) -> str:
        """What the values of the column are called in messages, such as "numbers"."""
        if self.is_text:
            return "names"
        if self.kind == Flags:
            return "true and false"
        return "whole numbers" if self.is_integer else "numbers"

    @property
    def is_integer(self) -> bool:
        """Whether the column holds whole numbers."""
        return self.kind == Integers


_COLUMNS: dict[type, tuple[Column, ...]] = {}


def columns_of(cls: type) -> tuple[Column, ...]:
    """Return the columns of a class of records, those that it inherits first."""
    if cls not in _COLUMNS:
        _COLUMNS[cls] = tuple(_parse_columns(cls))
    return _COLUMNS[cls]


def _parse_columns(cls: type) -> Iterator[Column]:
    """Yield the columns that the annotations of a class and its bases describe."""
    columns: dict[str, Column] = {}
    for base in reversed(cls.__mro__):
        for field, hint in get_annotations(base).items():
            if hasattr(hint, "__metadata__"):  # Annotated
                kind, axes, *marks = get_args(hint)
                columns[field] = _parse_column(field, kind, axes, marks)
    yield from columns.values()


def _parse_column(
    field: str, kind: object, axes: str, marks: Sequence[Unit | Named]
) -> Column:
    """Return the column that the annotation of a field describes.

    kind: its type; axes, such as "n p 3"; marks: unit and name, if any.
    """
    kinds = get_args(kind) if isinstance(kind, UnionType) else (kind,)
    name = field
    unit = ""
    for mark in marks:
        if isinstance(mark, Named):
            name = mark.text
        else:
            unit = mark.text
    return Column(
        field=field,
        name=name,
        axes=tuple(int(axis) if axis.isdigit() else axis for axis in axes.split()),
        kind=kinds[0],
        unit=unit,
        required=type(None) not in kinds,
    )


_BY_NAME: dict[type, Mapping[str, Column]] = {}


def column_by_name(cls: type) -> Mapping[str, Column]:
    """Return the columns of a class by their names in files."""
    if cls not in _BY_NAME:
        _BY_NAME[cls] = {column.name: column for column in columns_of(cls)}
    return _BY_NAME[cls]


def match_axes(
    axes: Sequence[str | int], shape: Sequence[int], sizes: dict[str, int]
) -> bool:
    """Whether an array's shape matches axes such as n, p, 3; add new sizes to `sizes`.

    An axis is a size, or a letter, which has one size in all arrays of a record.
    """
    if len(shape) != len(axes):
        return False
    fits = True
    for axis, size in zip(axes, shape, strict=True):
        wanted = sizes.setdefault(axis, size) if isinstance(axis, str) else axis
        fits = fits and wanted == size
    return fits


def as_kind(column: Column, value: object) -> Array | Texts:
    """Convert a value to the type of a column: an array, or a tuple of texts.

    Raises TypeError or ValueError where it cannot be converted.
    """
    if column.kind == Texts:
        return value if isinstance(value, tuple) else tuple(map(str, _elements(value)))
    if column.kind == Words:
        return np.asarray(value, object)
    if column.kind == Singles:
        numbers = np.asarray(value)
        return numbers if numbers.dtype.kind == "f" else numbers.astype(np.float32)
    if column.kind == Floats:
        numbers = np.asarray(value)
        if numbers.dtype == np.float64:
            return numbers
        with np.errstate(invalid="ignore", over="ignore"):  # checks find nan, inf
            return numbers.astype(np.float64)
    return _as_whole_numbers(np.asarray(value), np.int64 if column.is_integer else bool)


def _as_whole_numbers(values: Array, dtype: type) -> Array:
    """Convert values exactly to whole numbers or flags (dtype).

    Raises ValueError where that cannot be: fractions are no indices, and 2 is no flag.
    """
    if values.dtype == dtype:
        return values
    with np.errstate(invalid="ignore"):
        converted: Array = values.astype(dtype)
    if not np.array_equal(converted, values):
        raise ValueError("these are others")
    return converted


def _elements(value: object) -> Sequence[object]:
    """Return the elements of a sequence or an array. Raises TypeError for others."""
    if isinstance(value, np.ndarray):
        values: list[object] = value.tolist()
        return values
    if not isinstance(value, Sequence):
        raise TypeError(f"{value!r} is no sequence of names")
    return value


def complete(record: Items) -> None:
    """Convert the fields of a new record to their types, and check that axes agree.

    Raises InputError for what is no array of numbers, and for other shapes.
    """
    sizes: dict[str, int] = {}
    for column in _points_first(type(record)):
        value = getattr(record, column.field)
        if value is None or (column.kind == Texts and not len(value)):
            continue
        try:
            converted = as_kind(column, value)
        except (TypeError, ValueError):
            fault = f"is no array of {column.noun}"
            fix = f"give {column.noun}"
            raise input_error(_place_of(column, record), fault, fix) from None
        shape: tuple[int, ...] = (len(converted),)
        if isinstance(converted, np.ndarray):
            shape = converted.shape
        sizes_before = dict(sizes)
        if not match_axes(column.axes, shape, sizes):
            expected = tuple(sizes_before.get(str(axis), axis) for axis in column.axes)
            row = ", one landmark per row" if column.axes[-2:-1] == ("p",) else ""
            fix = f"it must be {expected}".replace("'", "") + row
            fault = f"has the shape {shape}"
            raise input_error(_place_of(column, record), fault, fix)
        if converted is not value:
            object.__setattr__(record, column.field, converted)


_POINTS_FIRST: dict[type, tuple[Column, ...]] = {}


def _points_first(cls: type[Items]) -> tuple[Column, ...]:
    """Return the columns of a class of records, its points before the others.

    The points say how many items and landmarks there are, and the rest must agree.
    """
    if cls not in _POINTS_FIRST:
        columns = columns_of(cls)
        _POINTS_FIRST[cls] = tuple(
            sorted(columns, key=lambda column: column.field != cls.POINTS)
        )
    return _POINTS_FIRST[cls]


def _place_of(column: Column, record: Items) -> str:
    """Return the name of a field in messages, such as `landmarks.confidence`."""
    points = type(record).POINTS
    return points if column.field == points else f"{points}.{column.field}"


def in_columns(points: Floats) -> Floats:
    """Return points (n, p, d) as a contiguous (n, d, p), one landmark a column.

    Sums round by the order in memory: what is computed must not depend on who made the
    array.
    """
    return np.ascontiguousarray(points.swapaxes(1, 2))


def present_columns(record: Items) -> Iterator[tuple[Column, Array | Texts]]:
    """Yield the columns of a record that are not None, with their values."""
    for column in columns_of(type(record)):
        value = getattr(record, column.field)
        if value is not None:
            yield column, value


def take_rows(record: Items, rows: NDArray[np.integer] | slice) -> dict[str, object]:
    """Return the item-wise fields of a record for the items `rows` alone, by name.

    For `replace`; transforms go with their image.
    """
    changes: dict[str, object] = {}
    for column, value in present_columns(record):
        if column.axes[0] == "n":
            changes[column.field] = _take(value, rows)
        elif column.axes[0] == "a":
            count = getattr(record, COUNTS)
            changes[column.field] = _take_counted(np.asarray(value), count, rows)
    changes["extras"] = {name: value[rows] for name, value in record.extras.items()}
    return changes


def _take(value: Array | Texts, rows: NDArray[np.integer] | slice) -> Array | Texts:
    """Return some rows of an array or of a tuple of texts, which may be empty."""
    if isinstance(value, np.ndarray):
        return value[rows]
    if isinstance(rows, slice):
        return value[rows]
    return tuple(value[row] for row in rows.tolist()) if len(value) else ()


def _take_counted(
    value: Array, count: Integers, rows: NDArray[np.integer] | slice
) -> Array:
    """Return the rows of an array that belong to items `rows`.

    count (n,): how many rows of the array, in the order of items, belong to each item.
    """
    ends = np.cumsum(count)
    taken = np.arange(len(count))[rows]
    ranges = [np.arange(ends[row] - count[row], ends[row]) for row in taken]
    taken_rows: Array = value[np.concatenate([np.empty(0, np.intp), *ranges])]
    return taken_rows
