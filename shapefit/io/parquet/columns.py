"""Arrays of NumPy as columns of Parquet, and back."""

from __future__ import annotations

from collections.abc import Callable
from math import prod
from typing import Any, NamedTuple

import numpy as np

from shapefit.errors import input_error
from shapefit.io.extras import Array
from shapefit.io.parquet.library import pyarrow

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
