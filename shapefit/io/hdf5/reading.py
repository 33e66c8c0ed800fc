"""Read the datasets of an HDF5 file, checked against its format."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from functools import cached_property
from pathlib import Path
from typing import Any, Literal, Self

import h5py
import numpy as np

from shapefit.errors import input_error, printable
from shapefit.io.extras import Extras, is_per_item
from shapefit.io.formats import HDF5, find_format
from shapefit.io.hdf5.opening import open_hdf5
from shapefit.io.hdf5.pieces import read_rows
from shapefit.io.hdf5.sizes import Stored, size_in_memory
from shapefit.io.hdf5.strangers import stranger
from shapefit.io.layout import (
    AXES,
    PER_ITEM_FLAG,
    PLAIN_ATTRIBUTES,
    UNKNOWN_UNIT,
    VERSION,
    Dataset,
    Format,
    plain_name,
)
from shapefit.io.memory import ALWAYS_FITS, check_fits, in_words
from shapefit.io.problems import input_problems
from shapefit.io.sources import source_name

BLOCK, BLOCK_BYTES = 16384, 1 << 24
"""Most items, and most bytes of them, that a check reads at a time."""


MOST_COMPRESSED = 2000
"""No filter of HDF5 makes data smaller by more: beyond that they were never written."""


class Hdf5Reader:
    """An open HDF5 file of a known format; a context manager.

    Opening checks the format and its version, and the kind and shape of every dataset, and reads
    the landmark names; all else is read when asked for. Whatever the file does wrong is an
    InputError that names file and dataset.
    """

    def __init__(self, path: Path, form: Format) -> None:
        self.path = path
        self.form = form
        self._asked: dict[str, Stored] = {}
        if find_format(path) is not HDF5:
            found = "is not an HDF5 file" if path.is_file() else "is not a file on a disk"
            raise input_error(source_name(path), found, f"give a {form.name} file")
        with self._damage():
            self._file = open_hdf5(path)
        try:
            self._check_format()
            self._check_datasets()
            self.landmark_names = self._read_landmark_names()
        except BaseException:
            self._file.close()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None:
        self._file.close()

    @property
    def unit(self) -> str:
        """Unit of lengths, as the file states it."""
        return str(self._root.get("unit", UNKNOWN_UNIT))

    @property
    def attributes(self) -> dict[str, str | float | int]:
        """Root attributes that the format does not define: texts and numbers."""
        return {
            plain_name(name): value
            for name, value in self._root.items()
            if name not in PLAIN_ATTRIBUTES and isinstance(value, str | int | float)
        }

    @property
    def y_axis(self) -> Literal["up", "down"]:
        """Whether y points up or down. Raises InputError for anything else."""
        direction = self._root.get("y_axis", "up")
        if direction == "up":
            return "up"
        if direction == "down":
            return "down"
        found = f"the root attribute y_axis is '{direction}'"
        raise input_error(self.path, found, "set it to up or down")

    @property
    def frame_rate(self) -> float | None:
        """Frames a second of a sequence; None where the file states none.

        Raises InputError for what is not a number > 0.
        """
        rate = self._root.get("frame_rate")
        if rate is None:
            return None
        if isinstance(rate, int | float) and not isinstance(rate, bool) and 0 < rate < math.inf:
            return float(rate)
        found = f"the root attribute frame_rate is {rate!r}"
        raise input_error(
            self.path, found, "set it to frames per second, a number > 0, or remove it"
        )

    def has(self, name: str) -> bool:
        """Whether the file has this dataset of its format."""
        return name in self._present

    def size(self, axis: str) -> int | None:
        """Length of an axis of the format (n items, p landmarks, ...); None if nothing has it."""
        return self._sizes.get(axis)

    @property
    def count(self) -> int:
        """Number of items."""
        return self._sizes["n"]

    def place(self, name: str, row: int | None = None) -> str:
        """Name a dataset, or a row of it, in messages."""
        return f"{self.path}:/{name}" + ("" if row is None else f"[{row}]")

    def read(self, name: str, rows: slice = slice(None)) -> Any:
        """Return rows of a dataset of the format in the orientation of memory; None if absent.

        Numbers come as float64, indices as int64, texts as a tuple of str, labels as they are.
        """
        if not self.has(name):
            return None
        dataset = next(known for known in self.form.datasets if known.name == name)
        values = self._values(name, rows)
        if dataset.kind == "text":
            return tuple(values)
        if dataset.kind == "label":
            return values.astype(str) if values.dtype.kind == "O" else values
        with np.errstate(invalid="ignore", over="ignore"):  # nan and inf are found by the checks
            array = np.asarray(values, np.int64 if dataset.kind == "index" else np.float64)
        return np.ascontiguousarray(array.swapaxes(-1, -2)) if dataset.points else array

    def read_blocks(self, name: str, part: slice | None = None) -> Iterator[Any]:
        """Read a dataset per item, or the rows of a part of it, at most some MB at a time."""
        rows = max(1, min(BLOCK, BLOCK_BYTES // max(self._size(name, slice(1)), 1)))
        start, stop, _ = (part or slice(None)).indices(self.count)
        return (
            self.read(name, slice(row, min(row + rows, stop))) for row in range(start, stop, rows)
        )

    def is_written(self, name: str) -> bool:
        """Whether anything was ever written to a dataset; a sparse file can be without limits."""
        with self._damage(name):
            return bool(self._file[name].id.get_storage_size())

    def fields(
        self, rows: slice = slice(None), *, without: Collection[Dataset] = ()
    ) -> dict[str, Any]:
        """Return these rows of all datasets of the format, by field of the record.

        Datasets that are counted by another one come whole. Those in `without` are not read.
        """
        chosen = {
            dataset: rows if dataset.per_item else slice(None)
            for dataset in self.form.datasets
            if dataset not in without
        }
        self._check_fits({dataset.name: part for dataset, part in chosen.items()})
        return {dataset.attribute: self.read(dataset.name, chosen[dataset]) for dataset in chosen}

    def extras(self, rows: slice = slice(None)) -> Extras:
        """Return these rows of the datasets that the format does not know."""
        per_item, whole = self._extra_names
        self._check_fits(dict.fromkeys(per_item, rows) | dict.fromkeys(whole, ()))
        return Extras(
            {name: self._values(name, rows) for name in per_item},
            {name: np.asarray(self._values(name, ())) for name in whole},
        )

    @cached_property
    def _extra_names(self) -> tuple[list[str], list[str]]:
        found: list[Any] = []
        with self._damage():
            self._file.visititems(lambda name, node: found.append((name, node)))
        per_item: list[str] = []
        whole: list[str] = []
        for name, dataset in found:
            if not isinstance(name, str) or not _is_text_of_files(name):
                strange = f"there is a name that is not plain UTF-8: {printable(name)}"
                raise input_error(self.path, strange, "rename it or remove it")
            if name in self.form.names or not isinstance(dataset, h5py.Dataset):
                continue
            with self._damage(name):
                carried = dataset.shape is not None and (
                    _is_text(dataset) or dataset.dtype.kind in "biufc"
                )
                flagged = bool(dataset.attrs.get(PER_ITEM_FLAG, True))
            if not carried:
                fix = "store numbers or text, or remove it"
                raise input_error(self.place(name), "cannot be carried over", fix)
            mine = flagged and is_per_item(name, dataset.shape, self.count)
            (per_item if mine else whole).append(name)
        return per_item, whole

    def _check_fits(self, chosen: Mapping[str, slice | tuple[()]]) -> None:
        """Raise InputError where these rows of datasets are more than memory holds."""
        sizes = {
            name: self._size(name, rows)
            for name, rows in chosen.items()
            if self.has(name) or name not in self.form.names
        }
        largest = max(sizes, key=lambda name: sizes[name], default="")
        check_fits(self.place(largest), sum(sizes.values()), "with the other datasets it")

    def _check_written(self, name: str) -> None:
        """Raise InputError for a large dataset that takes next to no place in the file."""
        with self._damage(name):
            dataset = self._file[name]
            size, stored = dataset.nbytes, dataset.id.get_storage_size()
        if size > MOST_COMPRESSED * stored:
            found = f"of its {in_words(size)} the file holds {in_words(stored)}"
            raise input_error(self.place(name), found, "write its values, or make it smaller")

    def _size(self, name: str, rows: slice | tuple[()]) -> int:
        with self._damage(name):
            return size_in_memory(self._stored(name), rows)

    def _stored(self, name: str) -> Stored:
        if name not in self._asked:
            self._asked[name] = Stored.of(self._file[name])
        return self._asked[name]

    def _values(self, name: str, rows: slice | tuple[()]) -> Any:
        size = self._size(name, rows)
        check_fits(self.place(name), size)
        if size > ALWAYS_FITS:
            self._check_written(name)
        try:
            with self._damage(name):
                texts = read_rows(self._stored(name), rows)
            if not self._stored(name).text:
                return texts
        except UnicodeDecodeError as error:
            fix = "write its strings as UTF-8"
            raise input_error(self.place(name), "holds text that is not UTF-8", fix) from error
        if "\0" in "".join(np.ravel(texts)):
            raise input_error(self.place(name), "holds a string with a zero byte", "remove it")
        return texts

    def _check_format(self) -> None:
        with self._damage():
            stored = {name: _plain(value) for name, value in self._file.attrs.items()}
        self._root = {name: value for name, value in stored.items() if value is not None}
        for name, value in self._root.items():
            if isinstance(value, str) and not _is_text_of_files(value):
                place, fix = f"{self.path}: root attribute {name}", "write it as UTF-8"
                raise input_error(place, "is not UTF-8 text, or has a zero byte", fix)
        found = self._root.get("format")
        if found is None:
            with self._damage():
                wrong = stranger(self._file, self.form.name)
            raise input_error(self.path, *wrong)
        if found != self.form.name:
            raise input_error(self.path, f"is a {found} file", f"give a {self.form.name} file")
        version = self._root.get("version")
        if version != VERSION:
            said = "has no root attribute version" if version is None else f"has version {version}"
            fix = f"this program reads version {VERSION}"
            if isinstance(version, str):
                said, fix = f"has the version '{version}' as text", f"store the number {VERSION}"
            raise input_error(self.path, said, fix)

    def _check_datasets(self) -> None:
        self._sizes: dict[str, int] = {}
        self._present: set[str] = set()
        problems: list[str] = []
        for dataset in self.form.datasets:
            with self._damage(dataset.name):
                node = self._file.get(dataset.name)
            if isinstance(node, h5py.Dataset):
                self._present.add(dataset.name)
                with self._damage(dataset.name):
                    wrong = _wrong_kind(node, dataset) or self._wrong_shape(node, dataset)
            elif node is None and not dataset.required:
                continue
            else:
                found = "there is no such dataset" if node is None else "is not a dataset"
                wrong = f"{found}; {_wanted(dataset)}"
            if wrong:
                problems.append(f"{self.place(dataset.name)}: {wrong}")
        if problems:
            raise input_problems(problems)

    def _wrong_shape(self, node: Any, dataset: Dataset) -> str | None:
        shape = node.shape or ()
        agrees = len(shape) == len(dataset.axes)
        for axis, length in zip(dataset.axes, shape, strict=False):
            size = self._sizes.setdefault(axis, length) if isinstance(axis, str) else axis
            agrees = agrees and size == length
        if agrees:
            return None
        sizes = ", ".join(str(self._sizes.get(str(axis), axis)) for axis in dataset.axes)
        return f"has the shape {shape}; {_wanted(dataset)}, here ({sizes})"

    def _read_landmark_names(self) -> tuple[str, ...]:
        names: tuple[str, ...] = self.read("landmark_names")
        known: set[str] = set()
        for row, name in enumerate(names):
            place = self.place("landmark_names", row)
            if not name:
                raise input_error(place, "is empty", "give every landmark a name")
            if name in known:
                fix = "give every landmark a unique name"
                raise input_error(place, f"repeats the name '{name}'", fix)
            known.add(name)
        return names

    @contextmanager
    def _damage(self, name: str = "") -> Iterator[None]:
        """Turn what h5py raises for a truncated or damaged file into an InputError."""
        try:
            yield
        except UnicodeDecodeError:
            raise
        except (OSError, RuntimeError, KeyError, TypeError, ValueError) as error:
            place = self.place(name) if name else self.path
            reason = str(error).partition("\n")[0]
            fix = "the file may be cut off or damaged: copy or make it again"
            raise input_error(place, f"cannot be read ({reason})", fix) from error


def _is_text(dataset: Any) -> bool:
    return h5py.check_string_dtype(dataset.dtype) is not None


def _wrong_kind(node: Any, dataset: Dataset) -> str | None:
    text = _is_text(node)
    fits = {
        "number": node.dtype.kind in "biuf",
        "index": node.dtype.kind in "iu",
        "text": text,
        "label": text or node.dtype.kind in "iu",
    }
    if fits[dataset.kind]:
        return None
    return f"holds values of type {'text' if text else node.dtype}; {_wanted(dataset)}"


def _wanted(dataset: Dataset) -> str:
    """Say how to store a dataset: `store numbers (items, landmarks, 3)`."""
    kinds = {"number": "numbers", "index": "integers", "text": "UTF-8 text", "label": "UTF-8 text"}
    axes = ", ".join(AXES.get(str(axis), str(axis)) for axis in dataset.axes)
    return f"store {kinds[dataset.kind]} ({axes})"


def _plain(value: Any) -> Any:
    """Return an attribute as Python's own str, int or float; as a list where it is an array.

    None for one that is empty.
    """
    if isinstance(value, h5py.Empty):
        return None
    if isinstance(value, np.ndarray):
        return _plain(value.flat[0]) if value.size == 1 else value.tolist()
    if isinstance(value, bytes):
        return value.decode("utf-8", "replace")
    return value.item() if isinstance(value, np.generic) else value


def _is_text_of_files(text: str) -> bool:
    # h5py gives bytes that are not UTF-8 as lone surrogates, which no file can hold.
    return not any("\ud800" <= letter <= "\udfff" or letter == "\0" for letter in text)
