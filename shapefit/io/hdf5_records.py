"""Our own HDF5 files: read, checked by their layout, and written so that damage is an error.

Metadata have checksums by their version of HDF5 (`libver` v110), values by `fletcher32`. Texts have
a fixed length, since HDF5 has no checksums for texts of any length.
"""

from __future__ import annotations

import errno
import math
import os
import re
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Integers
from shapefit.errors import abbreviate, input_error, listed, printable
from shapefit.io.atomic import atomic_path, storage_errors
from shapefit.io.checks import input_problems
from shapefit.io.hdf5_file import Hdf5File, as_text
from shapefit.io.layout import (
    AXES,
    DICTIONARY,
    FIELDS,
    LAYOUTS,
    PER_ITEM,
    RENAMED,
    RESULTS,
    UNKNOWN_UNIT,
    VERSION,
    Column,
    Layout,
    fit_axes,
)
from shapefit.io.options import RecordWriter
from shapefit.io.records import KINDS, Attribute

Array = NDArray[Any]

CHUNK_BYTES, MIN_CHUNK_ROWS = 1 << 18, 64

LIBVER = ("v110", "v110")
"""Version of HDF5 from which on all metadata have checksums; 1.10 and later read it."""

SPARE, END_OF_FILE = 1 << 21, 28
"""Bytes reserved beside what is written; where the superblock has the length of the file."""

PLAIN_ATTRIBUTES = frozenset(
    {"format", "version", "unit", "y_axis", "frame_rate", "attributes_sha256"}
)
"""Root attributes that the formats define, or once did."""
PREFIX = "shapefit_"
"""Before the names of other attributes of these names."""

STORED = {
    "number": ("biuf", "numbers"),
    "index": ("iu", "integers"),
    "text": ("O", "UTF-8 text"),
    "label": ("Oiu", "UTF-8 text"),
}
"""Types of NumPy that the kinds of datasets can have in files, O for text, and what they hold."""


def hdf5_kind(path: Path) -> str:
    """Return the kind of the layout that a file says it has. Raises InputError for other files."""
    with Hdf5File(path) as file:
        return LAYOUTS[_check_format(file, *LAYOUTS)].kind


def _check_format(file: Hdf5File, *formats: str) -> str:
    """Return the attribute `format`. Raises InputError where it is none of these."""
    stated = as_text(file.attribute("format"))
    if stated is None:
        with file.damage():
            holds = abbreviate([printable(name) for name in sorted(file.root)]) or "nothing"
        missing = f"has no root attribute format, and holds {holds}"
        fix = "give a file of DeepLabCut, SLEAP, JABS, NWB (nwb_version) or movement (ds_type), or"
        fix += f" set it, in a file of shapefit, to {listed(formats)}"
        raise input_error(file.path, missing, fix)
    if stated not in formats:
        raise input_error(file.path, f"is a {stated} file", f"give a {listed(formats)} file")
    return str(stated)


class Hdf5Reader(Hdf5File):
    """An open HDF5 file of a known layout; a context manager.

    Opening checks layout and version, kind and shape of every dataset, and the landmark names; all
    else is read when asked for. With `old` results and dictionaries of version 1 are read, too.
    Raises InputError that names file and dataset for whatever is wrong.
    """

    def __init__(self, path: Path, form: Layout, *, old: bool = False) -> None:
        super().__init__(path)
        self.form = form
        self._sizes: dict[str, int] = {}
        self._ends: dict[str, Integers] = {}
        try:
            self._attributes = self._read_attributes(old)
            self._names = self._find_datasets()
            if problems := list(self._problems()):
                raise input_problems(problems)
            self.landmark_names: tuple[str, ...] = self.read("landmark_names")
            if "" in self.landmark_names or len({*self.landmark_names}) < len(self.landmark_names):
                fault = "holds an empty name, or one twice"
                raise self.fault("landmark_names", fault, "give every landmark a unique name")
        except BaseException:
            self.close()
            raise

    @property
    def count(self) -> int:
        """Number of items."""
        return self._sizes["n"]

    @property
    def attributes(self) -> dict[str, Attribute]:
        """Attributes that the layout does not define: texts and numbers."""
        return {
            name.removeprefix(PREFIX): value
            for name, value in self._attributes.items()
            if name not in PLAIN_ATTRIBUTES and isinstance(value, str | int | float)
        }

    @property
    def stated(self) -> dict[str, Any]:
        """unit, y_axis and frame_rate, None where the file does not say it.

        Raises InputError for a direction that is not up or down, and a rate that is not > 0.
        """
        y_axis, rate = self._attributes.get("y_axis"), self._attributes.get("frame_rate")
        if y_axis not in (None, "up", "down"):
            fault = f"the root attribute y_axis is '{y_axis}'"
            raise input_error(self.path, fault, "set it to up or down")
        if rate is not None and not (isinstance(rate, int | float) and 0 < rate < math.inf):
            fault = f"the root attribute frame_rate is {rate!r}"
            raise input_error(self.path, fault, "set it to frames per second, a number > 0")
        unit = str(self._attributes.get("unit", UNKNOWN_UNIT))
        return {"unit": unit, "y_axis": y_axis, "frame_rate": rate and float(rate)}

    def records(self, rows: slice, without: Collection[str] = ()) -> Any:
        """Return the items in these rows, without some datasets."""
        columns: dict[str, Any] = {}
        whole: dict[str, Any] = {}
        for name in sorted(self._names.keys() - self.form.datasets.keys() - {*without}):
            per_item = self._is_per_item(name)
            values = self.rows(self._names[name], rows if per_item else ())
            (columns if per_item else whole)[name] = np.asarray(values)
        kind: Any = KINDS[self.form.kind]
        return kind(
            **self.fields(rows, without),
            columns=columns,
            whole=whole,
            **self.stated,
            attributes=self.attributes if self.form is RESULTS else None,
        )

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
            ends = self._row_ends(column)
            rows = slice(int(ends[start]), int(ends[max(start, stop)]))
        values = self.rows(self._names[name], rows if column.per_item else ())
        if column.kind == "text":
            return tuple(values)
        if column.kind == "label":
            return values.astype(str) if values.dtype.kind == "O" else values
        with np.errstate(invalid="ignore", over="ignore"):  # nan and inf are found by the checks
            array = np.asarray(values, np.int64 if column.kind == "index" else np.float64)
        return np.ascontiguousarray(array.swapaxes(-1, -2)) if column.points else array

    def _row_ends(self, column: Column) -> Integers:
        """Return where the rows of items begin in a counted dataset, and the last ends (n + 1,)."""
        name, axis = column.counted_by, str(column.axes[0])
        if name not in self._ends:
            counts = self.read(name)
            self._ends[name] = ends = np.cumsum([0, *counts])
            if (counts < 0).any() or ends[-1] != self._sizes[axis]:
                fault = f"does not count the {self._sizes[axis]} {AXES[axis]}"
                raise self.fault(name, fault, "the file was changed: fit again")
        return self._ends[name]

    def _read_attributes(self, old: bool) -> dict[str, Any]:
        """Return the attributes of the root, format and version checked."""
        _check_format(self, self.form.name)
        with self.damage():
            names = list(self.root.attrs)
        root = {name: as_text(self.attribute(name)) for name in names}
        version = root.get("version")
        if version == 1 and not old and self.form in (RESULTS, DICTIONARY):
            fix = f"write it anew: shapefit convert {self.path.name} -o NEW.h5"
            raise input_error(self.path, "is of version 1, an earlier format", fix)
        if version not in (1, VERSION):
            fix = f"this program reads version {VERSION}, a number"
            raise input_error(self.path, f"has the root attribute version {version!r}", fix)
        return root

    def _find_datasets(self) -> dict[str, str]:
        """Return where each dataset lies, by its name of today."""
        nodes: dict[Any, Any] = {}
        with self.damage():
            self.root.visititems(lambda name, node: nodes.update({name: node}))  # no soft links
            nodes |= {name: self.root[name] for name in self.form.all if name in self.root}
            if not all(isinstance(name, str) for name in nodes):
                raise ValueError("a name is not UTF-8")
        renamed = RENAMED if self._attributes["version"] == 1 else {}
        names = [name for name, node in nodes.items() if isinstance(node, h5py.Dataset)]
        return {renamed.get(name, name): name for name in names}

    def _problems(self) -> Iterator[str]:
        """Yield what is wrong with the kind or shape of each dataset."""
        for name, column in self.form.all.items():
            letters, values = STORED[column.kind]
            fault = "there is no such dataset" if column.required else ""
            if name in self._names:
                node, text, shape = self.stored(self._names[name])
                kind = "O" if text else node.dtype.kind.replace("O", "?")
                fault = (
                    "" if fit_axes(column.axes, shape, self._sizes) else f"has the shape {shape}"
                )
                if kind not in letters:
                    fault = f"holds values of type {'text' if text else node.dtype}"
            if fault:
                axes = [f"{self._sizes.get(str(a), '')} {AXES.get(str(a), a)}" for a in column.axes]
                axes_text = ", ".join(map(str.strip, axes))
                yield f"{self.place(name)}: {fault}; store {values} ({axes_text})"

    def _is_per_item(self, name: str) -> bool:
        """Whether a dataset that is in memory as in the file has a row for each item.

        Those that no layout lists have an attribute that states it, in version 2.
        """
        node, _, shape = self.stored(self._names[name])
        if shape[:1] != (self._sizes.get("n"),):
            return False
        if name in self.form.further or self._attributes["version"] == 1:
            return self.form.is_per_item(name, len(shape))
        with self.damage(name):
            return bool(node.attrs.get(PER_ITEM, False))


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
    too. Texts per item are held until then, when their greatest length is known. Datasets stay open
    to the end: what HDF5 cannot write when one of them is closed by itself is no error.
    """

    def __init__(self, file: Any, form: Layout, reserve: Callable[[int], None]) -> None:
        super().__init__()
        self._file, self._form, self._reserve = file, form, reserve
        self._first: Any = None
        self._whole: dict[str, Array] = {}
        self._shapes: dict[str, tuple[int, ...]] = {}
        self._texts: dict[str, list[Array]] = {}
        self._open: dict[str, h5py.Dataset] = {}

    def append(self, record: Any) -> None:
        """Write the items of a record after those that are there.

        Raises ValueError where its landmarks or datasets are not those of the first record.
        """
        rows, whole = _as_stored(record, self._form)
        shapes = {name: values.shape[1:] for name, values in rows.items()}
        if not self.begun:
            self.begun, self._first, self._whole, self._shapes = True, record, whole, shapes
        if record.landmark_names != self._first.landmark_names or shapes != self._shapes:
            raise ValueError("the landmarks or datasets of this record are not those of the first")
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
            width = max(block.dtype.itemsize for block in blocks)
            for block in blocks:
                self._write_rows(name, block.astype(h5py.string_dtype("utf-8", width)))
        for name, values in self._whole.items():
            stored = _encoded(values) if values.dtype.kind in "OU" else values
            self._reserve(2 * stored.nbytes)
            checked = stored.size > 0 and stored.ndim > 0  # HDF5 has no checksum for one value
            self._open[name] = self._file.create_dataset(name, data=stored, fletcher32=checked)
        for name in self._shapes.keys() - self._form.datasets.keys():
            self._open[name].attrs[PER_ITEM] = True
        stated: dict[str, Any] = {"format": self._form.name, "version": VERSION}
        for name in ("unit", "y_axis", "frame_rate"):
            stated[name] = getattr(self._first, name, None)
        for name, value in self.attributes.items():
            stated[PREFIX + name if name in PLAIN_ATTRIBUTES else name] = value
        self._reserve(sum(len(str(value)) for value in stated.values()) * 4)
        for name, value in stated.items():
            if value is not None:
                self._file.attrs[name] = value
        self._file.flush()
        self._open.clear()

    def _write_rows(self, name: str, values: Array) -> None:
        """Write rows of a dataset behind those that are there, in chunks of a power of two."""
        rest = values.shape[1:]
        if name not in self._open:
            row_bytes = max(values.itemsize * math.prod(rest), 1)
            rows = max(1, min(CHUNK_BYTES // row_bytes, max(len(values), MIN_CHUNK_ROWS)))
            rows = 1 << (rows.bit_length() - 1)
            self._reserve(rows * row_bytes)
            self._open[name] = self._file.create_dataset(
                name,
                shape=(0, *rest),
                maxshape=(None, *(size or None for size in rest)),
                chunks=(rows, *(max(size, 1) for size in rest)),
                dtype=values.dtype,
                fletcher32=True,
            )
        self._reserve(values.nbytes)
        dataset = self._open[name]
        start = len(dataset)
        dataset.resize(start + len(values), axis=0)
        dataset[start:] = values


def _as_stored(record: Any, form: Layout) -> tuple[dict[str, Array], dict[str, Array]]:
    """Return what a record, or a dictionary, holds as it stands in a file: per item, and whole."""
    rows = dict(getattr(record, "per_item", {}))
    whole = dict(getattr(record, "whole", {}))
    for name, column in form.datasets.items():
        if (value := getattr(record, FIELDS.get(name, name), None)) is not None:
            array = np.asarray(value, object if column.kind == "text" else column.stored or None)
            array = array.swapaxes(-1, -2) if column.points else array
            (rows if column.per_item else whole)[name] = array
    return rows, whole


def _encoded(texts: Array) -> Array:
    """Return texts in UTF-8, each as long as the longest."""
    encoded = [str(text).encode("utf-8", "backslashreplace") for text in np.ravel(texts)]
    kind = h5py.string_dtype("utf-8", max(map(len, encoded), default=0) or 1)
    return np.array(encoded, kind).reshape(texts.shape)


@contextmanager
def _disk_space(path: Path) -> Iterator[Callable[[int], None]]:
    """Give a function that reserves space for bytes to come, as HDF5 crashes on a full disk.

    Space that was not needed is freed once the file is closed.
    """
    needed = reserved = 0

    def reserve(size: int) -> None:
        nonlocal needed, reserved
        needed += size + size // 50  # for metadata
        if needed > reserved and hasattr(os, "posix_fallocate"):
            reserved = needed + SPARE + min(needed, 7 * SPARE)
            try:
                os.posix_fallocate(file.fileno(), 0, reserved)
            except OSError as error:
                if error.errno not in (errno.EINVAL, errno.EOPNOTSUPP):
                    raise

    with path.open("r+b") as file:
        reserve(0)
        yield reserve
        size = int.from_bytes(os.pread(file.fileno(), 8, END_OF_FILE), "little")
        if os.fstat(file.fileno()).st_size > size > END_OF_FILE:
            os.ftruncate(file.fileno(), size)


@contextmanager
def _system_errors() -> Iterator[None]:
    """Turn what HDF5 raises where the system refuses to write into the OSError behind it."""
    try:
        yield
    except (OSError, RuntimeError) as error:
        number = re.search(r"errno = (\d+)", str(error))
        if number is None:
            raise
        raise OSError(int(number[1]), os.strerror(int(number[1]))) from error
