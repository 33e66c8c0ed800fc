"""Our own HDF5 files: read, checked by their layout, and written so that damage is an error.

Metadata have checksums by their version of HDF5 (`libver` v110), values by `fletcher32`. Texts have
a fixed length, since HDF5 has no checksums for texts of any length; those of the root attributes,
which are plain texts, have one in an attribute.
"""

from __future__ import annotations

import errno
import hashlib
import math
import os
import re
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Integers
from shapefit.errors import abbreviate, input_error, printable
from shapefit.io.atomic import atomic_path, storage_errors
from shapefit.io.checks import input_problems
from shapefit.io.hdf5_file import Hdf5File, as_text
from shapefit.io.layout import (
    AXES,
    DIGEST,
    FIELDS,
    LAYOUTS,
    PER_ITEM,
    PLAIN_ATTRIBUTES,
    RENAMED,
    UNKNOWN_UNIT,
    VERSION,
    Column,
    Layout,
    fit_axes,
)
from shapefit.io.options import RecordWriter
from shapefit.io.records import KINDS, Attribute

Array = NDArray[Any]

CACHE_BYTES = 1 << 20
"""Of chunks that are kept for each dataset; by default HDF5 keeps 8 MB, and rows are read once."""

CHUNK_BYTES, MIN_CHUNK_ROWS = 1 << 18, 64

LIBVER = ("v110", "v110")
"""Version of HDF5 from which on all metadata have checksums; 1.10 and later read it."""

SPARE, END_OF_FILE = 1 << 21, 28
"""Bytes reserved beside what is written; where the superblock has the length of the file."""

OTHER_TOOLS = "DeepLabCut, SLEAP, JABS, NWB (the attribute nwb_version) or movement (ds_type)"
"""The HDF5 files of other tools that are read."""

PREFIX = "shapefit_"
"""Before the names of root attributes that the format has for itself."""

KIND_LETTERS = {"number": "biuf", "index": "iu", "text": "O", "label": "Oiu"}
"""Types of NumPy that the kinds of datasets can have in files, O for text."""
KIND_WORDS = {"number": "numbers", "index": "integers", "text": "UTF-8 text", "label": "UTF-8 text"}

CHANGED = "the file was changed: fit again"


def hdf5_kind(path: Path) -> str:
    """Return the kind of the layout that a file says it has. Raises InputError for other files."""
    with Hdf5File(path) as file:
        name = _format_of(file)
    if not isinstance(name, str) or name not in LAYOUTS:
        found = f"is a {name} file" if isinstance(name, str) else "has a format that is no text"
        raise input_error(path, found, f"give one of {', '.join(LAYOUTS)}")
    return LAYOUTS[name].kind


def _format_of(file: Hdf5File, expected: str = "a format of shapefit") -> Any:
    if (found := as_text(file.attribute("format"))) is None:
        with file.damage():
            holds = abbreviate([printable(name) for name in sorted(file.root)]) or "nothing"
        missing = f"has no root attribute format, and holds {holds}"
        fix = f"give a file of {OTHER_TOOLS}, or set it to {expected} if the file has that layout"
        raise input_error(file.path, missing, fix)
    return found


def digest_of(attributes: Mapping[str, Any]) -> str:
    """SHA-256 of the attributes that are texts, which HDF5 stores without checksums.

    Those that can have few values are left out: damage is seen by the value.
    """
    checked = ("format", "y_axis", DIGEST)
    texts = sorted((k, v) for k, v in attributes.items() if isinstance(v, str) and k not in checked)
    return hashlib.sha256(repr(texts).encode("utf-8", "surrogatepass")).hexdigest()


class Hdf5Reader(Hdf5File):
    """An open HDF5 file of a known layout; a context manager.

    Opening checks layout and version, kind and shape of every dataset, and the landmark names; all
    else is read when asked for. `old` files of version 1 have other names (RENAMED); of their
    further datasets those with n rows are per item unless they state otherwise. Raises InputError
    that names file and dataset for whatever is wrong.
    """

    def __init__(self, path: Path, form: Layout, *, old: bool = False) -> None:
        super().__init__(path, CACHE_BYTES)
        self.form = form
        self._sizes: dict[str, int] = {}
        self._ends: dict[str, Integers] = {}
        try:
            self._attributes = self._read_attributes((1, *form.versions) if old else form.versions)
            self._names = self._find_datasets()
            self._check_datasets()
            self.landmark_names: tuple[str, ...] = self.read("landmark_names")
            if "" in self.landmark_names or len({*self.landmark_names}) < len(self.landmark_names):
                self._raise_for_names()
            self.per_item, self.whole = self._divide_further()
        except BaseException:
            self.close()
            raise

    def _raise_for_names(self) -> None:
        before = {""}
        for row, name in enumerate(self.landmark_names):
            if name in before:
                found = f"repeats the name '{name}'" if name else "is empty"
                fix = "give every landmark a unique name" if name else "give every landmark a name"
                raise input_error(self.place("landmark_names", row), found, fix)
            before.add(name)

    @property
    def count(self) -> int:
        """Number of items."""
        return self._sizes["n"]

    @property
    def attributes(self) -> dict[str, Attribute]:
        """Attributes that the layout does not define: texts and numbers."""
        retained = {n: v for n, v in self._attributes.items() if isinstance(v, str | int | float)}
        for name in PLAIN_ATTRIBUTES:
            retained.pop(name, None)
            if PREFIX + name in retained:
                retained[name] = retained.pop(PREFIX + name)
        return retained

    @property
    def stated(self) -> dict[str, Any]:
        """unit, y_axis and frame_rate, None where the file does not say it.

        Raises InputError for a direction that is not up or down, and a rate that is not > 0.
        """
        y_axis, rate = self._attributes.get("y_axis"), self._attributes.get("frame_rate")
        if y_axis not in (None, "up", "down"):
            found = f"the root attribute y_axis is '{y_axis}'"
            raise input_error(self.path, found, "set it to up or down")
        number = isinstance(rate, int | float) and not isinstance(rate, bool)
        if rate is not None and not (number and 0 < rate < math.inf):
            found = f"the root attribute frame_rate is {rate!r}"
            fix = "set it to frames per second, a number > 0, or remove it"
            raise input_error(self.path, found, fix)
        unit = str(self._attributes.get("unit", UNKNOWN_UNIT))
        rate = None if rate is None else float(rate)
        return {"unit": unit, "y_axis": y_axis, "frame_rate": rate}

    def records(self, rows: slice, without: Collection[str] = ()) -> Any:
        """Return the items in these rows, without some datasets."""
        kind: Any = KINDS[self.form.kind]
        return kind(
            **self.fields(rows, without),
            columns={
                name: self._values(name, rows) for name in self.per_item if name not in without
            },
            whole={n: np.asarray(self._values(n)) for n in self.whole if n not in without},
            **self.stated,
            attributes=self.attributes if self.form.kind == "result" else None,
        )

    def large(self, size: int, items: int) -> set[str]:
        """Return carried datasets, and vertices, that take more bytes for so many items."""
        large = set()
        for name in {*self.per_item, *self.whole, "mesh_vertices"} & self._names.keys():
            stored = self.stored(self._names[name])
            needed = math.prod(stored.shape) * stored.itemsize
            if name not in self.whole:
                needed = needed // max(self.count, 1) * min(items, self.count)
            if needed > size:
                large.add(name)
        return large

    def fields(self, rows: slice = slice(None), without: Collection[str] = ()) -> dict[str, Any]:
        """Return what the datasets of the layout hold of these items, by field of the record."""
        chosen = [name for name in self.form.datasets if name not in without]
        return {FIELDS.get(name, name): self.read(name, rows) for name in chosen}

    def read(self, name: str, rows: slice = slice(None)) -> Any:
        """Return a dataset of the layout in the orientation of memory; None if absent.

        Of what grows with the items, that is the part of the items in `rows`. Numbers come as
        float64, indices as int64, texts as a tuple of str, labels as they are.
        """
        column = self.form.datasets[name]
        if not {name, column.counted_by or name} <= self._names.keys():
            return None
        if column.counted_by:
            start, stop, _ = rows.indices(self.count)
            ends = self._row_ends(name, column)
            rows = slice(int(ends[start]), int(ends[max(start, stop)]))
        values = self._values(name, rows if column.per_item else ())
        if column.kind == "text":
            return tuple(values)
        if column.kind == "label":
            return values.astype(str) if values.dtype.kind == "O" else values
        with np.errstate(invalid="ignore", over="ignore"):  # nan and inf are found by the checks
            array = np.asarray(values, np.int64 if column.kind == "index" else np.float64)
        return np.ascontiguousarray(array.swapaxes(-1, -2)) if column.points else array

    def _values(self, name: str, rows: slice | tuple[()] = ()) -> Any:
        name = self._names[name]
        values = self.rows(name, rows)
        if self.stored(name).text and "\0" in "".join(np.ravel(values)):
            raise self.fault(name, "holds a string with a zero byte", "remove it")
        return values

    def _row_ends(self, name: str, column: Column) -> Integers:
        """Return where the rows of items begin in a counted dataset, and the last ends (n + 1,)."""
        if name in self._ends:
            return self._ends[name]
        counts: Integers = self.read(column.counted_by)
        axis = str(column.axes[0])
        length = self._sizes.get(axis, 0)
        most = (self._sizes.get("k") if axis == "a" else None) or length
        wrong = np.flatnonzero((counts < 0) | (counts > most))
        if len(wrong):
            found = f"is {counts[wrong[0]]}, not a number of {AXES[axis]}"
            raise input_error(self.place(column.counted_by, int(wrong[0])), found, CHANGED)
        self._ends[name] = ends = np.concatenate([[0], np.cumsum(counts)])
        if ends[-1] != length:
            found = f"holds {length} {AXES[axis]}, and {column.counted_by} counts {ends[-1]}"
            raise input_error(self.place(name), found, CHANGED)
        return ends

    def _read_attributes(self, versions: Collection[int]) -> dict[str, Any]:
        """Return the attributes of the root, format, version and digest checked."""
        with self.damage():
            stored = {name: as_text(self.attribute(name)) for name in self.root.attrs}
        root = {name: value for name, value in stored.items() if value is not None}
        for name, value in root.items():
            if isinstance(value, str) and not _is_utf8(value):
                place, fix = f"{self.path}: root attribute {name}", "write it as UTF-8"
                raise input_error(place, "is not UTF-8 text, or has a zero byte", fix)
        if (found := _format_of(self, self.form.name)) != self.form.name:
            raise input_error(self.path, f"is a {found} file", f"give a {self.form.name} file")
        version = root.get("version")
        if version == 1 and version not in versions:
            fix = f"write it anew: shapefit convert {self.path.name} -o NEW.h5"
            raise input_error(self.path, "is of version 1, an earlier format", fix)
        if version not in versions or isinstance(version, bool):
            fix = f"this program reads version {VERSION}, a number"
            raise input_error(self.path, f"has the root attribute version {version!r}", fix)
        if root.pop(DIGEST, digest_of(root)) != digest_of(root):
            fix = f"if it was meant, remove the attribute {DIGEST}; else copy the file again"
            raise input_error(self.path, "a root attribute was changed or damaged", fix)
        return root

    def _find_datasets(self) -> dict[str, str]:
        """Return where each dataset lies, by its name of today."""
        nodes: dict[Any, Any] = {}
        with self.damage():
            self.root.visititems(lambda name, node: nodes.update({name: node}))  # no soft links
            soft = [name for name in self.form.all if name in self.root and name not in nodes]
            nodes |= {name: self.root[name] for name in soft}
        renamed = RENAMED if self._attributes["version"] < VERSION else {}
        datasets: dict[str, str] = {}
        for name, node in nodes.items():
            if not isinstance(name, str) or not _is_utf8(name):
                found = f"there is a name that is not plain UTF-8: {printable(name)}"
                raise input_error(self.path, found, "rename it or remove it")
            if isinstance(node, h5py.Dataset):
                with self.damage(name):
                    readable = node.shape is not None and _kind(node) in (*"biufc", "O")
                if not readable and name not in self.form.all:
                    raise self.fault(name, "cannot be carried over", "store numbers or text")
                datasets[renamed.get(name, name)] = name
            elif name in self.form.all:
                raise self.fault(name, "is not a dataset", _wanted(self.form.all[name]))
        return datasets

    def _check_datasets(self) -> None:
        """Raise InputError for datasets of another kind or shape than the layout has."""
        problems = []
        for name, column in self.form.all.items():
            wrong = ""
            if name in self._names:
                with self.damage(name):
                    node = self.root[self._names[name]]
                    kind, shape = _kind(node), node.shape or ()
                if not kind or kind not in KIND_LETTERS[column.kind]:
                    wrong = f"holds values of type {'text' if kind == 'O' else node.dtype}"
                    wrong += f"; {_wanted(column)}"
                elif not fit_axes(column.axes, shape, self._sizes):
                    sizes = ", ".join(str(self._sizes.get(str(axis), axis)) for axis in column.axes)
                    wrong = f"has the shape {shape}; {_wanted(column)}, here ({sizes})"
            elif column.required:
                wrong = f"there is no such dataset; {_wanted(column)}"
            if wrong:
                problems.append(f"{self.place(name)}: {wrong}")
        if problems:
            raise input_problems(problems)

    def _divide_further(self) -> tuple[list[str], list[str]]:
        """Return the datasets that memory has as the file has them: per item, and of the file."""
        per_item: list[str] = []
        whole: list[str] = []
        for name in sorted(self._names.keys() - self.form.names):
            stored, column = self.stored(self._names[name]), self.form.all.get(name)
            with self.damage(name):
                flag = column.per_item if column else stored.dataset.attrs.get(PER_ITEM)
            if flag is None and self._attributes["version"] < VERSION:
                flag = self.form.is_per_item(name, len(stored.shape))
                flag = flag and stored.shape[:1] == (self.count,)
            if flag and stored.shape[:1] != (self.count,):
                found = f"has the shape {stored.shape}, and says that it is per item"
                raise self.fault(name, found, f"store a row for each of {self.count} items")
            (per_item if flag else whole).append(name)
        return per_item, whole


def _wanted(column: Column) -> str:
    """Say how to store a dataset: `store numbers (items, landmarks, 3)`."""
    axes = ", ".join(AXES.get(str(axis), str(axis)) for axis in column.axes)
    return f"store {KIND_WORDS[column.kind]} ({axes})"


def _kind(dataset: Any) -> str:
    """Return the kind of NumPy of a dataset: O for text, and "" for other objects."""
    if h5py.check_string_dtype(dataset.dtype) is not None:
        return "O"
    return str(dataset.dtype.kind).replace("O", "")


def _is_utf8(text: str) -> bool:
    """Whether files can hold a text: h5py and JSON have lone surrogates for what is not UTF-8."""
    return not any("\ud800" <= letter <= "\udfff" or letter == "\0" for letter in text)


@contextmanager
def hdf5_output(target: Path, form: Layout) -> Iterator[Hdf5Writer]:
    """Give a writer to a file that appears on a clean exit."""
    with (
        atomic_path(target) as path,
        storage_errors(target, None),
        _system_errors(),
        _disk_space(path) as reserve,
        h5py.File(path, "w", libver=LIBVER, rdcc_nbytes=4 * CHUNK_BYTES, locking=False) as file,
    ):
        writer = Hdf5Writer(file, form, reserve)
        yield writer
        writer.finish()


class Hdf5Writer(RecordWriter[Any]):
    """Appends records of one layout to an HDF5 file.

    Datasets per item are chunked and extended along their first axis, what is not per item comes
    from the first record; `attributes` become root attributes at the end, those of the records
    too. Texts per item are held until then, when their greatest length is known.
    """

    def __init__(self, file: Any, form: Layout, reserve: Callable[[int], None]) -> None:
        super().__init__()
        self._file, self._form, self._reserve = file, form, reserve
        self._first: Any = None
        self._whole: dict[str, Array] = {}
        self._shapes: dict[str, tuple[int, ...]] = {}
        self._texts: dict[str, list[Array]] = {}

    def append(self, record: Any) -> None:
        """Write the items of a record after those that are there.

        Raises ValueError where its landmarks or datasets are not those of the first record.
        """
        rows, whole = _as_stored(record, self._form)
        shapes = {name: values.shape[1:] for name, values in rows.items()}
        if not self.begun:
            self.begun, self._first, self._whole, self._shapes = True, record, whole, shapes
        if record.landmark_names != self._first.landmark_names:
            raise ValueError("the landmarks of this record are not those of the first")
        if shapes != self._shapes:
            raise ValueError("the datasets of this record are not those of the first")
        for name, values in rows.items():
            if values.dtype.kind in "OU":
                self._texts.setdefault(name, []).append(_encoded(values))
            else:
                self._write_rows(name, values)
        self.attributes.update(getattr(record, "attributes", {}))

    def finish(self) -> None:
        """Write the texts, what belongs to the file, and the attributes."""
        self.check_begun()
        for name, blocks in self._texts.items():
            kind = h5py.string_dtype("utf-8", max(block.dtype.itemsize for block in blocks))
            for block in blocks:
                self._write_rows(name, block.astype(kind), kind)
        for name, values in self._whole.items():
            self._write_whole(name, values)
        for name in self._shapes.keys() - self._form.names:
            self._file[name].attrs[PER_ITEM] = True
        first = {
            name: getattr(self._first, name, None) for name in ("unit", "y_axis", "frame_rate")
        }
        stated: dict[str, Any] = {"format": self._form.name, "version": VERSION, **first}
        for name, value in self.attributes.items():
            stated[PREFIX + name if name in PLAIN_ATTRIBUTES else name] = value
        stated = {name: value for name, value in stated.items() if value is not None}
        self._reserve(sum(len(str(value)) for value in stated.values()) * 4)
        for name, value in (stated | {DIGEST: digest_of(stated)}).items():
            self._file.attrs[name] = value

    def _write_rows(self, name: str, values: Array, kind: Any = None) -> None:
        """Write rows of a dataset behind those that are there, in chunks of a power of two."""
        rest = values.shape[1:]
        if name not in self._file:
            row_bytes = max(values.itemsize * int(np.prod(rest, dtype=int)), 1)
            rows = max(1, min(CHUNK_BYTES // row_bytes, max(len(values), MIN_CHUNK_ROWS)))
            rows = 1 << (rows.bit_length() - 1)
            self._reserve(rows * row_bytes)
            self._file.create_dataset(
                name,
                shape=(0, *rest),
                maxshape=(None, *(size or None for size in rest)),
                chunks=(rows, *(max(size, 1) for size in rest)),
                dtype=kind or values.dtype,
                fletcher32=True,
            )
        self._reserve(values.nbytes)
        dataset = self._file[name].id
        start, *_ = dataset.shape
        dataset.set_extent((start + len(values), *rest))
        if values.size:  # in half the time of `dataset[start:] = values`
            place = dataset.get_space()
            place.select_hyperslab((start,) + (0,) * (values.ndim - 1), values.shape)
            space = h5py.h5s.create_simple(values.shape)
            values = np.ascontiguousarray(values)
            dataset.write(space, place, values, h5py.h5t.py_create(values.dtype, logical=True))

    def _write_whole(self, name: str, values: Array) -> None:
        """Write a dataset of the file, with a checksum unless it is a single value."""
        kind = None
        if values.dtype.kind in "OU":
            encoded = _encoded(values)
            kind = h5py.string_dtype("utf-8", encoded.dtype.itemsize)
            values = encoded.astype(kind)
        self._reserve(2 * values.nbytes)
        if values.size and values.ndim:
            chunks = values.shape if values.nbytes <= CHUNK_BYTES else True
            self._file.create_dataset(name, data=values, dtype=kind, chunks=chunks, fletcher32=True)
            return
        creation = h5py.h5p.create(h5py.h5p.DATASET_CREATE)  # in the metadata, with their checksum
        links = h5py.h5p.create(h5py.h5p.LINK_CREATE)
        creation.set_layout(h5py.h5d.COMPACT)
        links.set_create_intermediate_group(True)
        stored = h5py.h5t.py_create(values.dtype, logical=True)
        space = h5py.h5s.create_simple(values.shape) if values.ndim else h5py.h5s.create(0)
        place = h5py.h5d.create(self._file.id, name.encode(), stored, space, creation, links)
        if values.size:
            h5py.Dataset(place)[()] = values


def _as_stored(record: Any, form: Layout) -> tuple[dict[str, Array], dict[str, Array]]:
    """Return what a record, or a dictionary, holds as it stands in a file: per item, and whole."""
    rows: dict[str, Array] = {}
    whole: dict[str, Array] = {}
    for name, column in form.datasets.items():
        if (value := getattr(record, FIELDS.get(name, name), None)) is not None:
            array = np.asarray(value, object if column.kind == "text" else None)
            array = array.astype(column.stored) if column.stored else array
            array = array.swapaxes(-1, -2) if column.points else array
            (rows if column.per_item else whole)[name] = array
    for there, columns in ((rows, "per_item"), (whole, "whole")):
        further = getattr(record, columns, {}).items()
        there |= {name: np.asarray(v) for name, v in further if name not in form.names}
    return rows, whole


def _encoded(texts: Array) -> Array:
    """Return texts in UTF-8, each as long as the longest. Raises InputError for zero bytes."""
    flat = [str(text) for text in np.ravel(texts)]
    if any("\0" in text for text in flat):
        raise input_error("output", "a text has a zero byte, which HDF5 cannot hold", "remove it")
    encoded = np.array([text.encode("utf-8", "surrogateescape") for text in flat] or [b""], "S")
    width = max(encoded.dtype.itemsize, 1)
    return encoded[: len(flat)].astype(f"S{width}").reshape(texts.shape)


@contextmanager
def _disk_space(path: Path) -> Iterator[Callable[[int], None]]:
    """Give a function that reserves space for bytes to come, as HDF5 crashes on a full disk.

    Space that was not needed is freed once the file is closed.
    """
    file = os.open(path, os.O_RDWR)
    needed, reserved = SPARE, 0

    def reserve(size: int) -> None:
        nonlocal needed, reserved
        needed += size + size // 50  # for metadata
        if needed > reserved:
            more = needed + min(needed, 8 * SPARE) - reserved
            try:
                os.posix_fallocate(file, reserved, more)
            except AttributeError:  # a system without it
                pass
            except OSError as error:
                if error.errno not in (errno.EINVAL, errno.EOPNOTSUPP, errno.ENOSYS):
                    raise
            reserved += more

    try:
        reserve(0)
        yield reserve
        size = int.from_bytes(os.pread(file, 8, END_OF_FILE), "little")
        if os.fstat(file).st_size > size > END_OF_FILE:
            os.ftruncate(file, size)
    finally:
        os.close(file)


@contextmanager
def _system_errors() -> Iterator[None]:
    """Turn what HDF5 raises where the system refuses to write into the OSError behind it."""
    try:
        yield
    except (OSError, RuntimeError) as error:
        found = re.search(r"errno = (\d+)", str(error))
        if found is None:
            raise
        raise OSError(int(found[1]), os.strerror(int(found[1]))) from error
