"""Arrays as columns of Parquet and back; which columns a dataset of a record is."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping
from math import prod
from typing import Any, NamedTuple

import numpy as np

from shapefit.errors import input_error
from shapefit.io.layout import AXES, Dataset, Layout, fits_kind, free_names
from shapefit.io.parquet.library import pyarrow
from shapefit.io.stored.writer import Array, as_stored, storable

types = pyarrow.types

Place = Callable[[int], str]
"""Names a row, counted from the first of those that were read, in messages."""


class ColumnType(NamedTuple):
    """What a column holds.

    kind   of its numbers as NumPy has it, O for text, "" for what we cannot read
    sizes  of the lists in a row, from the outside in; None where the type does not say it
    """

    kind: str
    sizes: tuple[int | None, ...]


def column_type(field: Any) -> ColumnType:
    """Return what a field of a schema holds."""
    kind = field.type
    sizes: list[int | None] = []
    while _is_list(kind):
        sizes.append(kind.list_size if types.is_fixed_size_list(kind) else None)
        kind = kind.value_type
    if types.is_dictionary(kind):
        kind = kind.value_type
    if types.is_string(kind) or types.is_large_string(kind):
        return ColumnType("O", tuple(sizes))
    if types.is_boolean(kind) or types.is_integer(kind) or types.is_floating(kind):
        return ColumnType(np.dtype(kind.to_pandas_dtype()).kind, tuple(sizes))
    return ColumnType("", tuple(sizes))


def to_column(values: Array) -> Any:
    """Return an array (n, ...) as a column: a list for each row, in the order of its last axis."""
    row = prod(values.shape[1:])
    flat = _to_values(values.reshape(-1))
    if values.ndim == 1:
        return flat
    if row:
        return pyarrow.FixedSizeListArray.from_arrays(flat, row)
    return pyarrow.ListArray.from_arrays(pyarrow.array([0] * (len(values) + 1)), flat)


def to_ragged_column(values: Array, counts: Array) -> Any:
    """Return rows (a, ...) of which each item has so many as a column of lists."""
    ends = np.cumsum(counts, dtype=np.int64) * prod(values.shape[1:])
    offsets = pyarrow.array(np.concatenate([[0], ends]).astype(np.int32))
    return pyarrow.ListArray.from_arrays(offsets, _to_values(values.reshape(-1)))


def to_array(column: Any, place: Place) -> Array:
    """Return a column (n,) as an array, one (n, m, ...) of lists that are all equally long.

    Missing numbers become NaN, missing texts empty. Raises InputError for missing lists and
    integers, and for lists of other lengths than the first.
    """
    shape = [len(column)]
    each = 1
    while _is_list(column.type):
        lengths = _lengths(column, _of_entries(place, each))
        length = int(lengths[0]) if len(lengths) else _fixed_size(column.type)
        if len(wrong := np.flatnonzero(lengths != length)):
            found = f"holds {lengths[wrong[0]]} values, and rows before it {length}"
            raise input_error(place(int(wrong[0]) // each), found, "give every row as many")
        shape.append(length)
        each *= max(length, 1)
        column = column.flatten()
    return _from_values(column, _of_entries(place, each)).reshape(shape)


def to_ragged(column: Any, place: Place) -> tuple[Array, Array]:
    """Return the values of lists one after the other, and how many each list has.

    Raises InputError for missing lists and integers.
    """
    lengths = _lengths(column, place)
    ends = np.cumsum(lengths)
    return _from_values(
        column.flatten(), lambda entry: place(int(np.searchsorted(ends, entry, side="right")))
    ), lengths


def in_one(column: Any) -> Any:
    """Return a column of a table as one array."""
    if column.num_chunks == 1:
        return column.chunk(0)
    return pyarrow.concat_arrays([pyarrow.array([], column.type), *column.chunks])


def _is_list(kind: Any) -> bool:
    return bool(types.is_list(kind) or types.is_large_list(kind) or types.is_fixed_size_list(kind))


def _fixed_size(kind: Any) -> int:
    return int(kind.list_size) if types.is_fixed_size_list(kind) else 0


def _of_entries(place: Place, each: int) -> Place:
    """Return what names the row of an entry, of which each row has so many."""
    return lambda entry: place(entry // each)


def _lengths(lists: Any, place: Place) -> Array:
    """Return the length of each list. Raises InputError where there is none."""
    if lists.null_count:
        found, fix = "is null", "give every row a list, with NaN for what is not known"
        raise input_error(place(_first_null(lists)), found, fix)
    if types.is_fixed_size_list(lists.type):
        return np.full(len(lists), lists.type.list_size)
    return np.asarray(lists.value_lengths().to_numpy(zero_copy_only=False), np.int64)


def _to_values(values: Array) -> Any:
    """Return a flat array as pyarrow has it."""
    if values.dtype.kind in "OU":
        return pyarrow.array(values.tolist(), pyarrow.string())
    return pyarrow.array(values.astype(values.dtype.newbyteorder("="), copy=False))


def _from_values(values: Any, place: Place) -> Array:
    if types.is_dictionary(values.type):
        values = values.dictionary_decode()
    if values.null_count and not types.is_floating(values.type):
        if types.is_integer(values.type) or types.is_boolean(values.type):
            raise input_error(place(_first_null(values)), "is null", "write a number")
        values = values.fill_null("")
    found: Array = values.to_numpy(zero_copy_only=False)
    return found


def _first_null(values: Any) -> int:
    return int(np.argmax(values.is_null().to_numpy(zero_copy_only=False)))


COORDINATES = ("x", "y", "z")
"""Columns of the landmarks of an image, or of its shape: a list each, one number per landmark."""

SHAPE, NAME, COMPLEX = "shape", "dataset", "complex"
"""Metadata of a column: the shape of a row, as JSON, where it has several axes; the name of the
dataset, where the column could not have it; the type of complex numbers, which are stored as pairs.
"""

TEXT_BYTES = 32
"""That a text counts for, whatever it is: row groups do not depend on how the items are called."""


class Column(NamedTuple):
    """A column to be written: its field, its values, and the bytes of a row before compression."""

    field: Any
    values: Any
    row_bytes: int

    @property
    def is_text(self) -> bool:
        """Whether it holds a text per item."""
        return bool(pyarrow.types.is_string(self.field.type))


def columns_of(dataset: Dataset, form: Layout) -> tuple[str, ...]:
    """Return the names of the columns that hold a dataset of the layout."""
    if dataset != form.points:
        return (dataset.name,)
    return COORDINATES[: int(dataset.axes[-1])]


def further_names(names: Iterator[str], form: Layout) -> dict[str, str]:
    """Return the column of each further dataset: x, y and z are taken."""
    return free_names(names, {*form.names, *COORDINATES})


def to_columns(record: Any, further: Mapping[str, Array], form: Layout) -> Iterator[Column]:
    """Yield all that a record has for each of its items, `further` datasets too, as columns."""
    for dataset in form.growing:
        value = getattr(record, dataset.attribute)
        if value is None:
            continue
        values = as_stored(dataset, value)
        names = columns_of(dataset, form)
        if dataset.counted_by:
            counts = next(each for each in form.datasets if each.name == dataset.counted_by)
            numbers = getattr(record, counts.attribute)
            yield _column(dataset.name, values, to_ragged_column(values, numbers))
        elif len(names) > 1:
            for axis, name in enumerate(names):
                yield _column(name, values[..., axis])
        else:
            yield _column(dataset.name, values)
    columns = further_names(iter(further), form)
    for name, values in further.items():
        metadata = {} if columns[name] == name else {NAME: name}
        stored = storable(values)
        if stored.dtype.kind == "c":
            metadata[COMPLEX] = stored.dtype.newbyteorder("=").name
            stored = np.stack([stored.real, stored.imag], axis=-1)
        if stored.dtype.kind == "f" and stored.dtype.itemsize > np.dtype(float).itemsize:
            found = f"the dataset {name} has numbers of {8 * stored.dtype.itemsize} bits"
            raise input_error("Parquet", found, "store them as float64, or write HDF5")
        yield _column(columns[name], stored, metadata=metadata)


def _column(
    name: str, values: Array, column: Any = None, metadata: dict[str, str] | None = None
) -> Column:
    row = values.shape[1:]
    said = dict(metadata or {})
    if len(row) > 1:
        said[SHAPE] = json.dumps(row)
    column = to_column(values) if column is None else column
    each = TEXT_BYTES if values.dtype.kind == "O" else values.itemsize
    return Column(pyarrow.field(name, column.type, metadata=said or None), column, prod(row) * each)


def said_of(field: Any, key: str) -> str | None:
    """Return what the metadata of a column says."""
    said = (field.metadata or {}).get(key.encode())
    return None if said is None else said.decode("utf-8", "replace")


Shape = tuple[int, ...]


def find_row_shapes(
    form: Layout,
    fields: Mapping[str, Any],
    sizes: dict[str, int],
    length: Callable[[str], int | None],
) -> tuple[dict[str, Shape], list[str]]:
    """Return the shape of a row of each dataset per item that is there, and what is wrong.

    fields  of the schema, by the names of the columns
    sizes   of the axes that are known, such as p; those that are found are added
    length  returns how many values the first row of a column has; None without rows
    """
    shapes: dict[str, Shape] = {}
    problems: list[str] = []
    for dataset in form.growing:
        columns = columns_of(dataset, form)
        if not (dataset.required or fields.keys() & columns):
            continue
        for name in columns:
            if name not in fields:
                problems.append(f"column {name}: there is no such column; {_wanted(dataset, form)}")
                continue
            kind = column_type(fields[name])
            is_list = len(dataset.axes) > 1 or bool(dataset.counted_by)
            if not fits_kind(kind.kind, dataset) or bool(kind.sizes) != is_list:
                found = f"holds values of type {fields[name].type}"
                problems.append(f"column {name}: {found}; {_wanted(dataset, form)}")
                continue
            axes = dataset.axes[1:] if len(columns) == 1 else dataset.axes[1:-1]
            row = None
            if not dataset.counted_by:
                sized = [size for size in kind.sizes if size is not None]
                row = prod(sized) if len(sized) == len(kind.sizes) else length(name)
            shape = _shape(axes, sizes, row)
            if row is not None and prod(shape) != row:
                found = f"holds lists of {row} values, not of {prod(shape)}"
                problems.append(f"column {name}: {found}; {_wanted(dataset, form)}")
            shapes[dataset.name] = shape if len(columns) == 1 else (*shape, len(columns))
    return shapes, problems


def _shape(axes: tuple[str | int, ...], sizes: dict[str, int], row: int | None) -> Shape:
    """Return the sizes of axes; one not known yet is what a row of so many values leaves."""
    known = [axis if isinstance(axis, int) else sizes.get(axis) for axis in axes]
    if None in known:
        rest = prod(size for size in known if size is not None)
        sizes[str(axes[known.index(None)])] = (row or 0) // max(rest, 1)
    return tuple(axis if isinstance(axis, int) else sizes[axis] for axis in axes)


def _wanted(dataset: Dataset, form: Layout) -> str:
    """Say how to store a dataset in a column."""
    if dataset == form.points:
        return "store lists of numbers, one for each landmark"
    kinds = {"number": "numbers", "index": "integers"}
    kind = kinds.get(dataset.kind, "UTF-8 text")
    if len(dataset.axes) == 1 and not dataset.counted_by:
        return f"store {kind}"
    axes = [AXES.get(str(axis), str(axis)) for axis in dataset.axes[1:]]
    return f"store lists of {kind}" + (f" ({' x '.join(axes)})" if axes else "")
