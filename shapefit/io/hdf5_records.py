"""Our own HDF5 files: datasets by their layout, checked when read; written with checksums.

Metadata have checksums by their version of HDF5 (`libver` v110), values by `fletcher32`, small
datasets lie in the metadata, and texts have a fixed length, since HDF5 has no checksums for texts
of any length. So damage is an error, and not another number.
"""

from __future__ import annotations

import errno
import math
import os
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from functools import cached_property
from pathlib import Path
from typing import Any, Literal, Self

import h5py
import numpy as np
from numpy.typing import NDArray

from shapefit import core
from shapefit.errors import abbreviate, input_error, printable
from shapefit.io.hdf5_file import Hdf5File
from shapefit.io.layout import (
    AXES,
    FURTHER_OF_RESULTS,
    LANDMARKS,
    LAYOUTS,
    PER_ITEM_FLAG,
    PLAIN_ATTRIBUTES,
    RESULTS,
    SHAPES,
    UNKNOWN_UNIT,
    VERSION,
    Dataset,
    Layout,
    fit_axes,
    fits_kind,
    is_per_item,
    plain_name,
    stored_name,
)
from shapefit.io.memory import check_fits
from shapefit.io.options import Summary
from shapefit.io.problems import input_problems
from shapefit.io.whole.atomic import atomic_path, storage_errors
from shapefit.io.writing import NOTHING_APPENDED

Array = NDArray[Any]

BLOCK, BLOCK_BYTES = 16384, 1 << 24
"""Most items, and most bytes of them, that a check reads at a time."""

CACHE_BYTES = 1 << 20
"""Of chunks that are kept for each dataset; by default HDF5 keeps 8 MB, and rows are read once."""

LOOKED_FOR = (
    "DeepLabCut (a table of pandas in the root)",
    "SLEAP (tracks and node_names, or metadata, frames and instances)",
    "JABS (poseest/points)",
    "NWB (the attribute nwb_version)",
    "movement (the attribute ds_type)",
)
KERAS = {"keras_version", "model_weights", "layer_names"}


def layout_of(path: Path) -> Layout:
    """Return the layout that an HDF5 file says it has. Raises InputError where it is not ours."""
    with Hdf5File(path) as file, file.damage():
        name = _text(file.attribute("format"))
        wrong = None if "format" in file.root.attrs else _not_ours(file.root)
    if wrong is not None:
        raise input_error(path, *wrong)
    if not isinstance(name, str) or name not in LAYOUTS:
        found = f"is a {name} file" if isinstance(name, str) else "has a format that is no text"
        raise input_error(path, found, f"give one of {', '.join(LAYOUTS)}")
    return LAYOUTS[name]


def read_attributes(path: Path) -> dict[str, str]:
    """Return the root attributes as texts, unchecked; nothing for what is no HDF5."""
    from shapefit.io.hdf5_file import open_hdf5

    try:
        with open_hdf5(path) as file:
            return {name: str(_text(value)) for name, value in file.attrs.items()}
    except OSError:
        return {}


class Hdf5Reader:
    """An open HDF5 file of a known layout; a context manager.

    Opening checks the layout and its version, and the kind and shape of every dataset, and reads
    the landmark names; all else is read when asked for. Whatever is wrong with the file is an
    InputError that names file and dataset.
    """

    def __init__(self, path: Path, form: Layout) -> None:
        self.path, self.form = path, form
        self._root: dict[str, Any] = {}
        self._sizes: dict[str, int] = {}
        self._present: set[str] = set()
        self._ends: dict[str, NDArray[np.int64]] = {}
        self._file = Hdf5File(path, CACHE_BYTES)
        try:
            self._check_format()
            self._check_datasets()
            self.landmark_names = self._check_landmark_names(self.read("landmark_names"))
        except BaseException:
            self._file.close()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def place(self, name: str, row: int | None = None) -> str:
        """Name a dataset, or a row of it, in messages."""
        return self._file.place(name, row)

    @property
    def unit(self) -> str:
        """Unit of lengths, as the file states it."""
        return str(self._root.get("unit", UNKNOWN_UNIT))

    @property
    def attributes(self) -> dict[str, str | float | int]:
        """Attributes that the layout does not define: texts and numbers."""
        return {
            plain_name(name): value
            for name, value in self._root.items()
            if name not in PLAIN_ATTRIBUTES and isinstance(value, str | int | float)
        }

    @property
    def y_axis(self) -> Literal["up", "down"] | None:
        """Whether y points up or down, where the file says it. Raises InputError for another."""
        direction = self._root.get("y_axis")
        if direction in (None, "up", "down"):
            return direction
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
        fix = "set it to frames per second, a number > 0, or remove it"
        raise input_error(self.path, found, fix)

    @property
    def names(self) -> frozenset[str]:
        """Names of what the root holds, groups too."""
        with self._file.damage():
            return frozenset(self._file.root)

    def has(self, name: str) -> bool:
        """Whether the file has this dataset of its layout."""
        return name in self._present

    def is_written(self, name: str) -> bool:
        """Whether anything was ever written to a dataset; a sparse file can be without limits."""
        with self._file.damage(name):
            return bool(self._file.root[name].id.get_storage_size())

    def size(self, axis: str) -> int | None:
        """Length of an axis of the layout (n items, p landmarks, ...); None if nothing has it."""
        return self._sizes.get(axis)

    @property
    def count(self) -> int:
        """Number of items."""
        return self._sizes["n"]

    def read(self, name: str, rows: slice = slice(None)) -> Any:
        """Return a dataset of the layout in the orientation of memory; None if absent.

        Of what grows with the items, that is the part of the items in `rows`. Numbers come as
        float64, indices as int64, texts as a tuple of str, labels as they are.
        """
        dataset = self.form.find(name)
        assert dataset is not None, name
        if not self.has(name) or (dataset.counted_by and not self.has(dataset.counted_by)):
            return None
        values = self._values(name, rows if dataset.grows else ())
        if dataset.kind == "text":
            return tuple(values)
        if dataset.kind == "label":
            return values.astype(str) if values.dtype.kind == "O" else values
        with np.errstate(invalid="ignore", over="ignore"):  # nan and inf are found by the checks
            array = np.asarray(values, np.int64 if dataset.kind == "index" else np.float64)
        return np.ascontiguousarray(array.swapaxes(-1, -2)) if dataset.points else array

    def read_blocks(self, name: str, part: slice | None = None) -> Iterator[Any]:
        """Read a dataset per item, or the rows of a part of it, at most some MB at a time."""
        start, stop, _ = (part or slice(None)).indices(self.count)
        most = max(1, min(BLOCK, stop - start))
        # Of many rows at once: a chunk of the file is counted with them, however few they are.
        taken = self._file.size(name, slice(start, start + most))
        rows = max(1, min(most, most * BLOCK_BYTES // max(taken, 1)))
        return (
            self.read(name, slice(row, min(row + rows, stop))) for row in range(start, stop, rows)
        )

    def fields(
        self, rows: slice = slice(None), *, without: Collection[Dataset] = ()
    ) -> dict[str, Any]:
        """Return what the datasets of the layout hold of these items, by attribute of the record.

        Those in `without` are not read.
        """
        chosen = [dataset for dataset in self.form.datasets if dataset not in without]
        self._check_fits({d.name: self._own_rows(d, rows) for d in chosen if self.has(d.name)})
        return {dataset.attribute: self.read(dataset.name, rows) for dataset in chosen}

    def further(self, rows: slice = slice(None)) -> dict[str, Any]:
        """Return these rows of the datasets that the layout does not know, as records take them.

        Raises InputError for those of a result that are not as a fit writes them.
        """
        per_item, whole = self._further_names
        self._check_fits(dict.fromkeys(per_item, rows) | dict.fromkeys(whole, ()))
        columns = {name: self._values(name, rows) for name in per_item}
        columns |= {name: np.asarray(self._values(name, ())) for name in whole}
        if self.form is RESULTS:
            self._check_further(columns, len(range(*rows.indices(self.count))))
        return {"columns": columns, "of_file": whole}

    def _check_further(self, columns: Mapping[str, Any], count: int) -> None:
        sizes = {"n": count, "p": len(self.landmark_names)}
        for dataset in FURTHER_OF_RESULTS:
            values = columns.get(dataset.name)
            if values is None:
                continue
            kind = "O" if values.dtype.kind == "U" else values.dtype.kind
            if not fits_kind(kind, dataset) or not fit_axes(dataset.axes, values.shape, sizes):
                found = f"holds {values.dtype} of the shape {values.shape}"
                fix = f"{_wanted(dataset)}, or remove it"
                raise input_error(self.place(dataset.name), found, fix)

    @cached_property
    def _further_names(self) -> tuple[list[str], list[str]]:
        """Names of the datasets that the layout does not know: per item, and of the file."""
        found: list[Any] = []
        with self._file.damage():
            self._file.root.visititems(lambda name, node: found.append((name, node)))
        per_item: list[str] = []
        whole: list[str] = []
        for name, dataset in found:
            if not isinstance(name, str) or not _is_text(name):
                strange = f"there is a name that is not plain UTF-8: {printable(name)}"
                raise input_error(self.path, strange, "rename it or remove it")
            if name in self.form.names or not isinstance(dataset, h5py.Dataset):
                continue
            with self._file.damage(name):
                carried = dataset.shape is not None and (
                    _holds_text(dataset) or dataset.dtype.kind in "biufc"
                )
                flagged = bool(dataset.attrs.get(PER_ITEM_FLAG, True))
            if not carried:
                fix = "store numbers or text, or remove it"
                raise self._file.fault(name, "cannot be carried over", fix)
            mine = flagged and is_per_item(name, dataset.shape, self.count)
            (per_item if mine else whole).append(name)
        return per_item, whole

    def _values(self, name: str, rows: slice | tuple[()]) -> Any:
        dataset = self.form.find(name)
        if dataset is not None and isinstance(rows, slice):
            rows = self._own_rows(dataset, rows)
        values = self._file.rows(name, rows)
        if self._file.stored(name).text and "\0" in "".join(np.ravel(values)):
            raise self._file.fault(name, "holds a string with a zero byte", "remove it")
        return values

    def _own_rows(self, dataset: Dataset, items: slice) -> slice | tuple[()]:
        """Return the rows that items have in a dataset: other ones where it is counted.

        Raises InputError where the counts do not fit the dataset.
        """
        if not dataset.grows:
            return ()
        if not dataset.counted_by:
            return items
        if not self.has(dataset.counted_by):
            return slice(0)
        if dataset.name not in self._ends:
            self._ends[dataset.name] = self._added_up(dataset)
        ends = self._ends[dataset.name]
        start, stop, _ = items.indices(self.count)
        return slice(int(ends[start]), int(ends[max(start, stop)]))

    def _added_up(self, dataset: Dataset) -> NDArray[np.int64]:
        """Return where the rows of each item begin, and the last ends (n + 1,)."""
        counts = self.read(dataset.counted_by)
        axis = str(dataset.axes[0])
        length = self.size(axis) or 0
        most = (self.size("k") if axis == "a" else None) or length
        wrong = np.flatnonzero((counts < 0) | (counts > most))
        if len(wrong):
            place = self.place(dataset.counted_by, int(wrong[0]))
            found = f"is {counts[wrong[0]]}, not a number of {AXES[axis]}"
            raise input_error(place, found, "the file was changed: fit again")
        ends = np.concatenate([[0], np.cumsum(counts)])
        if ends[-1] != length:
            found = f"holds {length} {AXES[axis]}, and {dataset.counted_by} counts {ends[-1]}"
            raise input_error(self.place(dataset.name), found, "the file was changed: fit again")
        return ends

    def _check_fits(self, chosen: Mapping[str, slice | tuple[()]]) -> None:
        """Raise InputError where these rows of datasets are more than memory holds."""
        sizes = {name: self._file.size(name, rows) for name, rows in chosen.items()}
        largest = max(sizes, key=lambda name: sizes[name], default="")
        check_fits(self.place(largest), sum(sizes.values()), "with the other datasets it")

    def _check_format(self) -> None:
        with self._file.damage():
            stored = {name: _text(self._file.attribute(name)) for name in self._file.root.attrs}
        self._root = {name: value for name, value in stored.items() if value is not None}
        for name, value in self._root.items():
            if isinstance(value, str) and not _is_text(value):
                place, fix = f"{self.path}: root attribute {name}", "write it as UTF-8"
                raise input_error(place, "is not UTF-8 text, or has a zero byte", fix)
        found = self._root.get("format")
        if found is None:
            with self._file.damage():
                wrong = _not_ours(self._file.root, self.form.name)
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
                wrong = f"{found}; {_wanted(dataset)}"
            if wrong:
                problems.append(f"{self.place(dataset.name)}: {wrong}")
        if problems:
            raise input_problems(problems)

    def _wrong_shape(self, node: Any, dataset: Dataset) -> str | None:
        shape = node.shape or ()
        if fit_axes(dataset.axes, shape, self._sizes):
            return None
        sizes = ", ".join(str(self._sizes.get(str(axis), axis)) for axis in dataset.axes)
        return f"has the shape {shape}; {_wanted(dataset)}, here ({sizes})"

    def _check_landmark_names(self, names: tuple[str, ...]) -> tuple[str, ...]:
        """Return the names. Raises InputError where one is empty or there twice."""
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


def _not_ours(file: Any, form: str = "") -> tuple[str, str]:
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


def _wanted(dataset: Dataset) -> str:
    """Say how to store a dataset: `store numbers (items, landmarks, 3)`."""
    kinds = {"number": "numbers", "index": "integers", "text": "UTF-8 text", "label": "UTF-8 text"}
    axes = ", ".join(AXES.get(str(axis), str(axis)) for axis in dataset.axes)
    return f"store {kinds[dataset.kind]} ({axes})"


def _wrong_kind(node: Any, dataset: Dataset) -> str | None:
    text = _holds_text(node)
    if fits_kind("O" if text else node.dtype.kind.replace("O", ""), dataset):
        return None
    return f"holds values of type {'text' if text else node.dtype}; {_wanted(dataset)}"


def _holds_text(dataset: Any) -> bool:
    return h5py.check_string_dtype(dataset.dtype) is not None


def _text(value: Any) -> Any:
    """Return an attribute, bytes as text."""
    return value.decode("utf-8", "replace") if isinstance(value, bytes) else value


def _is_text(text: str) -> bool:
    """Whether files can hold a text: h5py and JSON have lone surrogates for what is not UTF-8."""
    return not any("\ud800" <= letter <= "\udfff" or letter == "\0" for letter in text)


CHUNK_BYTES, CHUNK_ROWS = 1 << 18, 64

FEWEST_WRITTEN = 1024
"""Items that are written at a time, but for the last: small files come by a hundred."""

MOST_COMPACT = 1 << 14
"""Bytes of a dataset that lies in the metadata."""

SPARE = 1 << 21
"""Bytes that metadata may take beside what is written."""

STEP = 1 << 24
"""Bytes that are reserved beyond at a time, but for small files."""

END_OF_FILE = 28
"""Where the superblock of such a file has its length."""

LIBVER = ("v110", "v110")
"""Version of HDF5 from which on all metadata have checksums; 1.10 and later read it."""


@contextmanager
def hdf5_output(target: Path, form: Layout) -> Iterator[Hdf5Writer]:
    """Give a writer to a file that appears on a clean exit."""
    with atomic_path(target) as path, storage_errors(target, None):
        writer = Hdf5Writer(path, form)
        try:
            yield writer
            writer.finish()
        finally:
            writer.close()


class Hdf5Writer:
    """Appends records of one layout to an HDF5 file.

    Datasets per item are chunked and extended along their first axis, what is not per item comes
    from the first record; `attributes` become root attributes at the end, those of the records
    too. Texts per item are held until then, when their greatest length is known.
    """

    def __init__(self, path: Path, form: Layout) -> None:
        self.attributes: dict[str, str | float | int] = {}
        self.summary = Summary()
        self._path, self._form = path, form
        self._first: Any = None
        self._whole: dict[str, Array] = {}
        self._shapes: dict[str, tuple[int, ...]] = {}
        self._datasets: dict[str, Any] = {}
        self._waiting: dict[str, list[Array]] = {}
        self._texts: dict[str, list[Array]] = {}
        self._held = 0
        self._space = os.open(path, os.O_RDWR)
        self._reserved = self._end = self._pending = 0
        _allocate(self._space, 0, SPARE)  # of a full disk HDF5 says more than one can read
        self._file = h5py.File(path, "w", libver=LIBVER, rdcc_nbytes=4 * CHUNK_BYTES, locking=False)

    def append(self, record: Any) -> None:
        """Write the items of a record after those that are there.

        Raises ValueError where its landmarks or datasets are not those of the first record.
        """
        columns, of_file = getattr(record, "further", {}), getattr(record, "of_file", ())
        if self._first is None:
            self._first = record.take(slice(0)) if self._form.per_item else record
            self._whole = {name: columns[name] for name in columns if name in of_file}
        if record.landmark_names != self._first.landmark_names:
            raise ValueError("the landmarks of this record are not those of the first")
        rows = {
            dataset.name: _as_stored(dataset, getattr(record, dataset.attribute))
            for dataset in self._form.growing
            if getattr(record, dataset.attribute) is not None
        }
        # What was whole in the first record is per item by chance: it has as many rows as these.
        rows |= {name: v for name, v in columns.items() if name not in self._whole}
        shapes = {name: values.shape[1:] for name, values in rows.items()}
        self._shapes = self._shapes or shapes
        if shapes != self._shapes:
            raise ValueError("the datasets of this record are not those of the first")
        for name, values in rows.items():
            if values.dtype.kind in "OU":
                self._texts.setdefault(name, []).append(_encoded(values))
            else:
                self._waiting.setdefault(name, []).append(values)
        self._held += len(rows.get("item", ()))
        self.attributes.update(getattr(record, "attributes", {}))
        if self._held >= FEWEST_WRITTEN:
            self._write_waiting()

    def finish(self) -> None:
        """Write what waits, the texts, and the attributes."""
        if self._first is None:
            raise ValueError(NOTHING_APPENDED)
        self._write_waiting(last=True)
        for name, texts in self._texts.items():
            self._write_texts(name, texts)
        for dataset in self._form.datasets:
            value = getattr(self._first, dataset.attribute)
            if value is not None and not dataset.grows:
                self._store(dataset.name, _as_stored(dataset, value))
        for name, value in self._whole.items():
            self._store(name, np.asarray(value)).attrs[PER_ITEM_FLAG] = False
        said: dict[str, Any] = {
            "format": self._form.name,
            "version": VERSION,
            "unit": self._first.unit,
            "y_axis": getattr(self._first, "y_axis", None),
            "frame_rate": getattr(self._first, "frame_rate", None),
        } | {stored_name(name): value for name, value in self.attributes.items()}
        self._reserve(sum(len(str(value)) for value in said.values()) * 4)
        for name, value in said.items():
            if isinstance(value, str):
                text = np.array(value.encode("utf-8", "surrogateescape") or b"\0")
                kind = h5py.string_dtype("utf-8", max(text.itemsize, 1))
                self._file.attrs.create(name, text, dtype=kind)
            elif value is not None:
                self._file.attrs[name] = value

    def close(self) -> None:
        """Close the file, and give back the room that was not needed."""
        try:
            self._file.close()
            size = int.from_bytes(os.pread(self._space, 8, END_OF_FILE), "little")
            if os.fstat(self._space).st_size > size > END_OF_FILE:
                os.ftruncate(self._space, size)
        finally:
            os.close(self._space)

    def _write_waiting(self, *, last: bool = False) -> None:
        """Write the rows that wait; those that fill chunks, before the last."""
        self._held = 0
        rows = {name: np.concatenate(values) for name, values in self._waiting.items()}
        self._reserve(sum(values.nbytes for values in rows.values()))
        for name, values in rows.items():
            if name not in self._datasets:
                self._datasets[name] = self._extendable(name, values)
            dataset = self._datasets[name]
            start, chunk = dataset.shape[0], dataset.chunks[0]
            end = len(values) if last or not values.size else len(values) // chunk * chunk
            dataset.id.set_extent((start + end, *values.shape[1:]))
            whole = end // chunk * chunk if dataset.compression and values.dtype == "f8" else 0
            for at in range(0, whole, chunk):
                place = (start + at,) + (0,) * (values.ndim - 1)
                packed = deflated(values[at : at + chunk])
                dataset.id.write_direct_chunk(place, packed + fletcher32(packed))
            _write_rows(dataset, start + whole, values[whole:end])
            self._waiting[name] = [values[end:]]

    def _write_texts(self, name: str, texts: list[Array]) -> None:
        """Write texts per item, all of the length of the longest."""
        width = max(block.dtype.itemsize for block in texts)
        count, rest = sum(map(len, texts)), texts[0].shape[1:]
        self._reserve(width * count * int(np.prod(rest, dtype=int)))
        kind = h5py.string_dtype("utf-8", width)
        dataset = self._extendable(name, np.empty((count, *rest), f"S{width}"), kind)
        dataset.id.set_extent((count, *rest))
        start = 0
        for block in texts:
            if block.size:
                dataset[start : start + len(block)] = block.astype(kind)
            start += len(block)

    def _extendable(self, name: str, values: Array, kind: Any = None) -> Any:
        """Make an empty dataset for rows like these."""
        rest = values.shape[1:]
        row_bytes = max(values.itemsize * int(np.prod(rest, dtype=int)), 1)
        rows = max(1, min(CHUNK_BYTES // row_bytes, max(len(values), CHUNK_ROWS)))
        packed = name in self._form.sparse or (kind is not None and values.itemsize > CHUNK_ROWS)
        return self._file.create_dataset(
            name,
            shape=(0, *rest),
            maxshape=(None, *(size or None for size in rest)),
            chunks=(rows, *(max(size, 1) for size in rest)),
            dtype=kind or values.dtype,
            fletcher32=True,
            **({"compression": "gzip", "compression_opts": 1} if packed else {}),
        )

    def _store(self, name: str, values: Array) -> Any:
        """Store a dataset that does not grow: in the metadata, or in chunks."""
        kind = None
        if values.dtype.kind in "OU":
            values = _encoded(values)
            kind = h5py.string_dtype("utf-8", values.dtype.itemsize)
            values = values.astype(kind)
        self._reserve(values.nbytes)
        if values.nbytes <= MOST_COMPACT:
            return self._store_compact(name, values)
        return self._file.create_dataset(
            name, data=values, dtype=kind, chunks=True, fletcher32=True
        )

    def _store_compact(self, name: str, values: Array) -> Any:
        """Store a small dataset in the metadata; h5py itself cannot do that with a scalar."""
        creation = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
        creation.set_layout(h5py.h5d.COMPACT)
        groups = h5py.h5p.create(h5py.h5p.LINK_CREATE)
        groups.set_create_intermediate_group(True)
        kind = h5py.h5t.py_create(values.dtype, logical=True)
        space = h5py.h5s.create_simple(values.shape) if values.shape else h5py.h5s.create(0)
        place = h5py.h5d.create(self._file.id, name.encode(), kind, space, creation, groups)
        dataset = h5py.Dataset(place)
        if values.size:
            dataset[()] = values
        return dataset

    def _reserve(self, size: int) -> None:
        """Have the disk keep room for so many bytes more, so that HDF5 never meets a full one."""
        self._pending += size
        if self._end + self._pending + SPARE <= self._reserved:
            return
        self._file.flush()
        self._end, self._pending = self._file.id.get_filesize(), size
        needed = self._end + size + SPARE + min(self._end, STEP)
        _allocate(self._space, self._reserved, needed - self._reserved)
        self._reserved = needed


def _allocate(file: int, start: int, size: int) -> None:
    """Have the disk keep room, where that is possible; OSError where it is full."""
    try:
        os.posix_fallocate(file, start, size)
    except OSError as error:
        if error.errno not in (errno.EINVAL, errno.EOPNOTSUPP, errno.ENOSYS):
            raise
    except AttributeError:  # a system without it
        return


def _as_stored(dataset: Dataset, value: Any) -> Array:
    """Return a field of a record as it stands in a file: one point per row."""
    array = np.asarray(value, object) if dataset.kind == "text" else np.asarray(value)
    array = array.astype(dataset.stored) if dataset.stored else array
    return array.swapaxes(-1, -2) if dataset.points else array


def _encoded(texts: Array) -> Array:
    """Return texts in UTF-8, each as long as the longest. Raises InputError for zero bytes."""
    flat = [str(text) for text in np.ravel(texts)]
    if any("\0" in text for text in flat):
        raise input_error("output", "a text has a zero byte, which HDF5 cannot hold", "remove it")
    encoded = np.array([text.encode("utf-8", "surrogateescape") for text in flat] or [b""], "S")
    width = max(encoded.dtype.itemsize, 1)
    return encoded[: len(flat)].astype(f"S{width}").reshape(texts.shape)


def _write_rows(dataset: Any, start: int, values: Array) -> None:
    """Do what `dataset[start:] = values` does in twice the time."""
    if not values.size:
        return
    place = dataset.id.get_space()
    place.select_hyperslab((start,) + (0,) * (values.ndim - 1), values.shape)
    rows = h5py.h5s.create_simple(values.shape)
    values = np.ascontiguousarray(values)
    kind = h5py.h5t.py_create(values.dtype)
    dataset.id.write(rows, place, values, kind)


def deflated(values: Array) -> bytes:
    """Return float64 numbers, most of them 0, as HDF5 knows them by `gzip`."""
    numbers = np.ascontiguousarray(values, "<f8").reshape(-1).view(np.uint64)
    stream = np.empty(len(numbers) * 9 // 8 + 5, np.uint64)
    size = core.deflate(numbers=numbers, stream=stream)
    return stream.view(np.uint8)[:size].tobytes()


def fletcher32(data: bytes) -> bytes:
    """Return the checksum that HDF5 puts behind a chunk.

    Of 16-bit words w_1 .. w_m, the most significant byte first: sum w_i and sum (m + 1 - i) w_i
    modulo 65535, where 0 stands for words that are all 0 alone.
    """
    words = np.frombuffer(data + b"\0" * (len(data) % 2), ">u2").astype(np.uint64)
    parts = words.sum(), (words * np.arange(len(words), 0, -1, dtype=np.uint64)).sum()
    low, high = ((int(part) - 1) % 65535 + 1 if part else 0 for part in parts)
    return (high << 16 | low).to_bytes(4, "little")
