"""Read the datasets of an HDF5 file, checked against its layout."""

from __future__ import annotations

from functools import cached_property
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from shapefit.errors import abbreviate, input_error, printable
from shapefit.io.hdf5.file import Hdf5File
from shapefit.io.layout import (
    AXES,
    LANDMARKS,
    LAYOUTS,
    PER_ITEM_FLAG,
    SHAPES,
    Dataset,
    Layout,
    fit_axes,
    fits_kind,
    is_per_item,
)
from shapefit.io.problems import input_problems
from shapefit.io.stored.reader import StoredReader, is_text, wanted


class CountedRows:
    """Adds up the counts of a file; goes on from where the last items began or ended."""

    def __init__(self) -> None:
        self._known: dict[str, dict[int, int]] = {}

    def of(self, reader: Hdf5Reader, dataset: Dataset, items: slice) -> slice:
        """Return the rows of a counted dataset that belong to these items.

        Raises InputError where the counts do not fit the dataset.
        """
        start, stop, _ = items.indices(reader.count)
        known = self._known.get(dataset.name, {})
        if start in known and stop in known:
            return slice(known[start], known[stop])
        item, row = max((each for each in known.items() if each[0] <= start), default=(0, 0))
        first = row + _total(reader, dataset, slice(item, start))
        end = first + _total(reader, dataset, slice(start, stop))
        _check_length(reader, dataset, end, last=stop == reader.count)
        self._known[dataset.name] = {start: first, stop: end}
        return slice(first, end)


def _total(reader: Hdf5Reader, dataset: Dataset, items: slice) -> int:
    if items.start >= items.stop:
        return 0
    counts = reader.read(dataset.counted_by, items)
    axis = str(dataset.axes[0])
    most = reader.size("k") if axis == "a" else None
    most = most or reader.size(axis) or 0
    wrong = np.flatnonzero((counts < 0) | (counts > most))
    if len(wrong):
        place = reader.place(dataset.counted_by, items.start + int(wrong[0]))
        found = f"is {counts[wrong[0]]}, not a number of {AXES[axis]}"
        raise input_error(place, found, "the file was changed: fit again")
    return int(counts.sum())


def _check_length(reader: Hdf5Reader, dataset: Dataset, end: int, *, last: bool) -> None:
    axis = str(dataset.axes[0])
    length = reader.size(axis) or 0
    if end > length or (last and end != length):
        found = f"holds {length} {AXES[axis]}, and {dataset.counted_by} counts {end}"
        place = reader.place(dataset.name)
        raise input_error(place, found, "the file was changed: fit again")


LOOKED_FOR = (
    "DeepLabCut (a table of pandas in the root)",
    "SLEAP (tracks and node_names, or metadata, frames and instances)",
    "JABS (poseest/points)",
    "NWB (the attribute nwb_version)",
    "movement (the attribute ds_type)",
)

KERAS = {"keras_version", "model_weights", "layer_names"}


def stranger(file: Any, form: str = "") -> tuple[str, str]:
    """Return what is wrong with an open HDF5 file without the attribute `format`, and the fix.

    form is the layout that it should have, "" where any of ours would do.
    """
    entries, attributes = sorted(file), sorted(file.attrs)
    holds = abbreviate([printable(name) for name in entries]) or "nothing"
    found = f"has no root attribute format, and holds {holds}"
    if KERAS & {*entries, *attributes}:
        return found, "it is a model of Keras: give the landmarks that it found"
    own = f"set it to {form} if the file has that layout" if form else "a file of shapefit"
    if form and form not in (LANDMARKS.name, SHAPES.name):
        return found, own
    return found, f"give a file of {', '.join(LOOKED_FOR)}, or {own}"


CACHE_BYTES = 1 << 20
"""Of chunks that are kept for each dataset; by default HDF5 keeps 8 MB, and rows are read once."""


class Hdf5Reader(StoredReader):
    """An open HDF5 file of a known layout."""

    ATTRIBUTE = "root attribute"

    def __init__(self, path: Path, form: Layout) -> None:
        super().__init__(path, form)
        self._counted = CountedRows()
        self._file = Hdf5File(path, CACHE_BYTES)
        try:
            self._check_format()
            self._check_datasets()
            self.landmark_names = self._check_landmark_names(self.read("landmark_names"))
        except BaseException:
            self._file.close()
            raise

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def place(self, name: str, row: int | None = None) -> str:
        """Name a dataset, or a row of it, in messages."""
        return self._file.place(name, row)

    def is_written(self, name: str) -> bool:
        """Whether anything was ever written to a dataset; a sparse file can be without limits."""
        with self._file.damage(name):
            return bool(self._file.root[name].id.get_storage_size())

    @property
    def names(self) -> frozenset[str]:
        """Names of what the root holds, groups too."""
        with self._file.damage():
            return frozenset(self._file.root)

    @cached_property
    def _extra_names(self) -> tuple[list[str], list[str]]:
        found: list[Any] = []
        with self._file.damage():
            self._file.root.visititems(lambda name, node: found.append((name, node)))
        per_item: list[str] = []
        whole: list[str] = []
        for name, dataset in found:
            if not isinstance(name, str) or not is_text(name):
                strange = f"there is a name that is not plain UTF-8: {printable(name)}"
                raise input_error(self.path, strange, "rename it or remove it")
            if name in self.form.names or not isinstance(dataset, h5py.Dataset):
                continue
            with self._file.damage(name):
                carried = dataset.shape is not None and (
                    _is_text(dataset) or dataset.dtype.kind in "biufc"
                )
                flagged = bool(dataset.attrs.get(PER_ITEM_FLAG, True))
            if not carried:
                fix = "store numbers or text, or remove it"
                raise self._file.fault(name, "cannot be carried over", fix)
            mine = flagged and is_per_item(name, dataset.shape, self.count)
            (per_item if mine else whole).append(name)
        return per_item, whole

    def _bytes(self, name: str, rows: slice | tuple[()]) -> int:
        return self._file.size(name, self._own_rows(name, rows))

    def _own_rows(self, name: str, rows: slice | tuple[()]) -> slice | tuple[()]:
        """Return the rows that items have in a dataset: other ones where it is counted."""
        dataset = next((known for known in self.form.datasets if known.name == name), None)
        if dataset is None or not dataset.counted_by or not isinstance(rows, slice):
            return rows
        return self._counted.of(self, dataset, rows) if self.has(dataset.counted_by) else slice(0)

    def _values(self, name: str, rows: slice | tuple[()]) -> Any:
        texts = self._file.rows(name, self._own_rows(name, rows))
        if not self._file.stored(name).text:
            return texts
        if "\0" in "".join(np.ravel(texts)):
            raise self._file.fault(name, "holds a string with a zero byte", "remove it")
        return texts

    def _check_format(self) -> None:
        with self._file.damage():
            stored = {name: _decoded(self._file.attribute(name)) for name in self._file.root.attrs}
        self._root = {name: value for name, value in stored.items() if value is not None}
        self._check_texts()
        found = self._root.get("format")
        if found is None:
            with self._file.damage():
                wrong = stranger(self._file.root, self.form.name)
            raise input_error(self.path, *wrong)
        if found != self.form.name:
            raise input_error(self.path, f"is a {found} file", f"give a {self.form.name} file")
        self._check_version()

    def _check_datasets(self) -> None:
        problems: list[str] = []
        for dataset in self.form.datasets:
            with self._file.damage(dataset.name):
                node = self._file.root.get(dataset.name)
            if isinstance(node, h5py.Dataset):
                self._present.add(dataset.name)
                with self._file.damage(dataset.name):
                    wrong = _wrong_kind(node, dataset) or self._wrong_shape(node, dataset)
            elif node is None and not dataset.required:
                continue
            else:
                found = "there is no such dataset" if node is None else "is not a dataset"
                wrong = f"{found}; {wanted(dataset)}"
            if wrong:
                problems.append(f"{self.place(dataset.name)}: {wrong}")
        if problems:
            raise input_problems(problems)

    def _wrong_shape(self, node: Any, dataset: Dataset) -> str | None:
        shape = node.shape or ()
        if fit_axes(dataset.axes, shape, self._sizes):
            return None
        sizes = ", ".join(str(self._sizes.get(str(axis), axis)) for axis in dataset.axes)
        return f"has the shape {shape}; {wanted(dataset)}, here ({sizes})"


def _is_text(dataset: Any) -> bool:
    return h5py.check_string_dtype(dataset.dtype) is not None


def _wrong_kind(node: Any, dataset: Dataset) -> str | None:
    text = _is_text(node)
    if fits_kind("O" if text else node.dtype.kind.replace("O", ""), dataset):
        return None
    return f"holds values of type {'text' if text else node.dtype}; {wanted(dataset)}"


def _decoded(value: Any) -> Any:
    """Return an attribute, bytes as text."""
    return value.decode("utf-8", "replace") if isinstance(value, bytes) else value


def hdf5_form(path: Path) -> Layout:
    """Return the layout that an HDF5 file says it has. Raises InputError where it is not ours."""
    with Hdf5File(path) as file, file.damage():
        name = _decoded(file.attribute("format"))
        wrong = None if "format" in file.root.attrs else stranger(file.root)
    if wrong is not None:
        raise input_error(path, *wrong)
    if not isinstance(name, str) or name not in LAYOUTS:
        found = f"is a {name} file" if isinstance(name, str) else "has a format that is no text"
        raise input_error(path, found, f"give one of {', '.join(LAYOUTS)}")
    return LAYOUTS[name]
