"""Read the columns of a Parquet file as the datasets of a layout, checked against it."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Collection, Mapping
from functools import cached_property
from math import prod
from pathlib import Path
from typing import Any

import numpy as np

from shapefit.errors import abbreviate, input_error
from shapefit.io.layout import (
    DICTIONARY,
    LANDMARKS,
    LAYOUTS,
    RESULTS,
    SHAPES,
    Dataset,
    Layout,
    fit_axes,
    fits_kind,
)
from shapefit.io.memory import check_fits
from shapefit.io.parquet.columns import (
    COMPLEX,
    NAME,
    SHAPE,
    Place,
    column_type,
    columns_of,
    find_row_shapes,
    in_one,
    said_of,
    to_array,
    to_ragged,
)
from shapefit.io.parquet.library import (
    ColumnStream,
    damage,
    pyarrow,
    row_group_starts,
    stored_bytes,
)
from shapefit.io.parquet.metadata import NAMES, read_metadata, root_attributes, whole_datasets
from shapefit.io.problems import input_problems
from shapefit.io.stored.reader import StoredReader, is_text, wanted
from shapefit.io.stored.writer import Array
from shapefit.stores.reading import open_bytes
from shapefit.stores.urls import UrlPath

TEXT = 100
"""Bytes of a short text in memory, and of the place where it is held."""

COPIES, TEXT_COPIES = 2, 6
"""Of what is read: as pyarrow has it, and as the records have it; of long texts, as measured."""

NAME_THEM = (
    'add the metadata landmark_names, a JSON list such as ["nose", "tail"], or a column of this '
    "name with that list in every row (docs/files.md)"
)

LAYOUT = (
    "give columns item (text), x and y (lists of numbers, one for each landmark), for shapes also z"
)

BUFFER = 1 << 20
"""Bytes that are read at a time: without it pyarrow holds columns of whole row groups."""


class ParquetReader(StoredReader):
    """An open Parquet file of a known layout."""

    ATTRIBUTE = "metadata"

    def __init__(self, path: Path, form: Layout) -> None:
        super().__init__(path, form)
        self._streams: dict[tuple[str, ...], ColumnStream] = {}
        self._file, self._said = open_file(path)
        try:
            self._check(form)
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Close the file, and let go of what was decoded of it, which pyarrow does not."""
        self._streams.clear()
        self._file.close()
        self._file = None

    @property
    def names(self) -> frozenset[str]:
        """Names of all datasets."""
        per_item, whole = self._extra_names
        return frozenset({*self._present, *per_item, *whole})

    @property
    def groups(self) -> list[int]:
        """First row of every row group."""
        return row_group_starts(self._file)[:-1]

    def place(self, name: str, row: int | None = None) -> str:
        """Name the columns of a dataset, or a row of them, in messages."""
        known = next((each for each in self.form.datasets if each.name == name), None)
        columns = columns_of(known, self.form) if known else (self._columns.get(name, name),)
        noun = "column" if len(columns) == 1 else "columns"
        number = "" if row is None else f", row {row}"
        return f"{self.path}: {noun} {', '.join(columns)}{number}"

    def is_written(self, name: str) -> bool:
        """Whether the dataset has values: in Parquet all have."""
        return True

    def _check(self, form: Layout) -> None:
        with damage(self.path):
            fields = list(self._file.schema_arrow)
        self._fields = {field.name: field for field in fields}
        if len(self._fields) < len(fields):
            raise input_error(self.path, "has two columns of one name", "rename one of them")
        found = stated_form(self.path, self._said, self._fields)
        stated = "format" in self._said
        if found is not form and (stated or {found, form} != {SHAPES, RESULTS}):
            raise input_error(self.path, f"is a {found.name} file", f"give a {form.name} file")
        with damage(self.path):
            self._root = root_attributes(self._said)
            self._whole = whole_datasets(self._said)
        self._check_texts()
        if stated:
            self._check_version()
        self._columns: dict[str, str] = {}
        self._sizes["n"] = self._file.metadata.num_rows
        self.landmark_names = self._check_landmark_names(self._read_landmark_names())
        self._sizes["p"] = len(self.landmark_names)
        self._row_shapes = self._find_row_shapes()
        self._present |= {NAMES, *self._row_shapes}
        self._check_whole()

    def _read_landmark_names(self) -> tuple[str, ...]:
        """Return the names that the metadata has, or those in the first row of a column."""
        if NAMES in self._said:
            try:
                names = json.loads(self._said[NAMES])
            except ValueError:
                names = None
            texts = isinstance(names, list) and all(isinstance(name, str) for name in names)
            if not texts or not all(map(is_text, names)):
                found = "the metadata landmark_names is not a JSON list of texts"
                raise input_error(self.path, found, NAME_THEM)
            return tuple(names)
        if NAMES not in self._fields or not self.count:
            raise input_error(self.path, "does not name the landmarks", NAME_THEM)
        kind = column_type(self._fields[NAMES])
        if kind.kind != "O" or len(kind.sizes) != 1:
            raise input_error(self.place(NAMES), "does not hold lists of texts", NAME_THEM)
        return tuple(self._arrays((NAMES,), 0, 1)[0][0])

    def _check_same_names(self, start: int, stop: int) -> None:
        """Raise InputError where rows name the landmarks otherwise than the first one."""
        ((names, lengths),) = self._read((NAMES,), start, stop, to_ragged)
        p = len(self.landmark_names)
        wrong = np.flatnonzero(lengths != p)
        if not len(wrong):
            wrong = np.flatnonzero(
                (names.reshape(-1, p) != np.array(self.landmark_names)).any(axis=1)
            )
        if len(wrong):
            place = self.place(NAMES, start + int(wrong[0]))
            found = "names other landmarks than the first row, or in another order"
            raise input_error(place, found, "arrange all rows alike")

    def _check_whole(self) -> None:
        """Raise InputError where a dataset that is not per item is none of its layout."""
        for dataset in self.form.datasets:
            if dataset.grows or dataset.name not in self._whole:
                continue
            self._present.add(dataset.name)
            values = self._whole[dataset.name]
            fits = fit_axes(dataset.axes, values.shape, self._sizes)
            if not fits or not fits_kind(values.dtype.kind, dataset):
                found = f"holds {values.dtype} of the shape {values.shape}"
                raise input_error(self.place(dataset.name), found, wanted(dataset))

    @cached_property
    def _extra_names(self) -> tuple[list[str], list[str]]:
        known = {name for each in self.form.growing for name in columns_of(each, self.form)}
        for column, field in self._fields.items():
            if column in known or column == NAMES:
                continue
            if not column_type(field).kind:
                place, found = f"{self.path}: column {column}", f"holds {field.type}"
                raise input_error(place, found, "store numbers or text, or remove it")
            name = said_of(field, NAME)
            name = column if name is None or name in self.form.names else name
            if not name.strip("./") or "\0" in name:
                raise input_error(self.path, f"there is a column called {name!r}", "rename it")
            self._columns[name] = column
        return list(self._columns), [name for name in self._whole if name not in self.form.names]

    def _values(self, name: str, rows: slice | tuple[()]) -> Any:
        if name == NAMES:
            return self.landmark_names
        if name in self._whole:
            return self._whole[name]
        start, stop, _ = (rows if isinstance(rows, slice) else slice(None)).indices(self.count)
        check_fits(self.place(name), self._bytes(name, slice(start, stop)))
        dataset = next((known for known in self.form.datasets if known.name == name), None)
        if dataset is None:
            return self._further(name, start, stop)
        if dataset.counted_by:
            return self._counted(dataset, start, stop)
        if dataset == self.form.points and NAMES not in self._said:
            self._check_same_names(start, stop)
        shape = (stop - start, *self._row_shapes[name])
        arrays = self._arrays(columns_of(dataset, self.form), start, stop)
        if len(arrays) == 1:
            return arrays[0].reshape(shape)
        return np.stack([each.reshape(shape[:-1]) for each in arrays], axis=1).swapaxes(1, 2)

    def _counted(self, dataset: Dataset, start: int, stop: int) -> Array:
        """Return what some items have in a dataset of several rows for each."""
        ((values, lengths),) = self._read((dataset.name,), start, stop, to_ragged)
        (counts,) = self._arrays((dataset.counted_by,), start, stop)
        row_shape = self._row_shapes[dataset.name]
        wrong = np.flatnonzero(lengths != counts * prod(row_shape))
        if len(wrong):
            row = int(wrong[0])
            found = f"holds {lengths[row]} values, and {dataset.counted_by} is {counts[row]}"
            place = self.place(dataset.name, start + row)
            raise input_error(place, found, "the file was changed: fit again")
        return values.reshape(-1, *row_shape)  # type: ignore[no-any-return]

    def _further(self, name: str, start: int, stop: int) -> Array:
        """Return rows of a dataset that the layout does not know."""
        column = self._columns[name]
        (values,) = self._arrays((column,), start, stop)
        shape, kind = (said_of(self._fields[column], key) for key in (SHAPE, COMPLEX))
        with damage(self.place(name)):
            if shape is not None:
                values = values.reshape(len(values), *json.loads(shape))
            if kind is not None:
                values = np.ascontiguousarray(values).view(kind)[..., 0]
        return values

    def _arrays(self, columns: tuple[str, ...], start: int, stop: int) -> list[Array]:
        """Return rows of columns, which are decoded together."""
        arrays = self._read(columns, start, stop, to_array)
        for name, values in zip(columns, arrays, strict=True):
            if values.dtype.kind == "O" and "\0" in "".join(values.ravel()):
                place, found = f"{self.path}: column {name}", "holds a text with a zero byte"
                raise input_error(place, found, "remove it")
        return arrays

    def _read(
        self, columns: tuple[str, ...], start: int, stop: int, convert: Callable[..., Any]
    ) -> list[Any]:
        place = f"{self.path}: column {', '.join(columns)}"
        with damage(place):
            stream = self._streams.setdefault(columns, ColumnStream(self._file, columns))
            table = stream.read(start, stop)
            return [
                convert(in_one(table.column(name)), self._row_of(name, start)) for name in columns
            ]

    def _row_of(self, column: str, start: int) -> Place:
        return lambda row: f"{self.path}: column {column}, row {start + row}"

    def _bytes(self, name: str, rows: slice | tuple[()]) -> int:
        if name == NAMES or name in self._whole:
            return 0
        start, stop, _ = (rows if isinstance(rows, slice) else slice(None)).indices(self.count)
        dataset = next((known for known in self.form.datasets if known.name == name), None)
        columns = columns_of(dataset, self.form) if dataset else (self._columns[name],)
        return (stop - start) * sum(self._row_bytes(column) for column in columns)

    def _row_bytes(self, column: str) -> int:
        """Return the bytes of a row in memory, by what the file holds of it before compression."""
        if column_type(self._fields[column]).kind == "O":
            return max(TEXT, TEXT_COPIES * self._stored_bytes[column] // max(self.count, 1))
        stored = self._stored_bytes[column] // max(self.count, 1)
        return COPIES * max(stored, 8 * self._list_size(column))  # equal numbers take few bytes

    def _list_size(self, column: str) -> int:
        """Return how many values each row of a column has, where its type states it, or 0."""
        kind = self._fields[column].type
        return kind.list_size if pyarrow.types.is_fixed_size_list(kind) else 0

    @cached_property
    def _stored_bytes(self) -> Counter[str]:
        with damage(self.path):
            return stored_bytes(self._file)

    def _find_row_shapes(self) -> dict[str, tuple[int, ...]]:
        """Return the shape of a row of each dataset per item that is there."""
        shapes, problems = find_row_shapes(self.form, self._fields, self._sizes, self._first_length)
        if problems:
            raise input_problems([f"{self.path}: {text}" for text in problems])
        return shapes

    def _first_length(self, column: str) -> int | None:
        """Return how many values the first row of a column has; None without rows."""
        if not self.count:
            return None
        if stated := self._list_size(column):
            return stated
        (values,) = self._arrays((column,), 0, 1)
        return int(values.size)


def parquet_form(path: Path) -> Layout:
    """Return the layout that a file says it has, or that its columns are those of."""
    file, said = open_file(path)
    with file:
        return stated_form(path, said, {field.name for field in file.schema_arrow})


def open_file(path: Path) -> tuple[Any, dict[str, str]]:
    """Open a file; returns its metadata, too."""
    with damage(path):
        opened = open_bytes(path) if isinstance(path, UrlPath) else path
        file = pyarrow.parquet.ParquetFile(opened, buffer_size=BUFFER)
        try:
            return file, read_metadata(file.metadata.metadata)
        except BaseException:
            file.close()
            raise


def stated_form(path: Path, said: Mapping[str, str], columns: Collection[str]) -> Layout:
    """Return the layout of a file; without a word of it, that which has such columns."""
    name = said.get("format")
    if name is not None:
        if name in LAYOUTS and name != DICTIONARY.name:
            return LAYOUTS[name]
        kinds = ", ".join(known for known in LAYOUTS if known != DICTIONARY.name)
        raise input_error(path, f"is a {name} file", f"give one of {kinds}")
    if {"x", "y"} <= set(columns):
        return SHAPES if "z" in columns else LANDMARKS
    found = f"has no columns x and y, and holds {abbreviate(sorted(columns)) or 'nothing'}"
    raise input_error(path, found, LAYOUT)
