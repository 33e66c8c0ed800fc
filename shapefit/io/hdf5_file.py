"""HDF5, read: files of any tool, whose faults name file and dataset, and our own."""

from __future__ import annotations

import math
import os
import re
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple, Self

import h5py
import numpy as np

from shapefit.arrays import Integers
from shapefit.errors import InputError, input_error, listed, printable
from shapefit.io.checks import input_problems
from shapefit.io.chunks import SuspectChunks
from shapefit.io.contents import digest_contents
from shapefit.io.inputs import ALWAYS_FITS, check_fits, format_bytes
from shapefit.io.layout import (
    CONTENTS,
    COUNTS,
    DICTIONARY,
    DICTIONARY_POINTS,
    EDGES,
    INPUT_ROWS,
    LAYOUTS,
    PER_ITEM,
    RENAMED,
    RESULTS,
    SHAPES,
    UNKNOWN_UNIT,
    VERSION,
    Layout,
)
from shapefit.records.columns import (
    Array,
    Column,
    Texts,
    as_kind,
    match_axes,
)
from shapefit.records.items import Attribute, Direction, Items
from shapefit.records.names import all_composed

PLAIN_ATTRIBUTES = (
    "format",
    "version",
    "unit",
    "y_axis",
    "frame_rate",
    "attributes_sha256",
    CONTENTS,
    INPUT_ROWS,
)
"""Root attributes that the formats define, or once did."""
PREFIX = "shapefit_"
"""Before the names of other attributes of these names."""

NUMBER_KINDS, INTEGERS, TEXT = (
    ("biuf", "numbers"),
    ("iu", "integers"),
    ("O", "UTF-8 text"),
)
"""Types of NumPy that datasets can have in files, O for text, and what they hold."""

DAMAGED = "the file may be cut off or damaged: copy or make it again"

VALUE_BYTES = 16
"""Of memory for a number and its copy, while it is read."""

TEXT_BYTES = 100
"""Of memory for a short text, while it is read."""

CACHE_BYTES = 1 << 20
"""Of chunks that are kept for each dataset; by default HDF5 keeps 8 MB, and rows are
read once.
"""

MAX_COMPRESSION = 2000
"""No filter of HDF5 makes data smaller by more: beyond that they were never written."""


def open_hdf5(path: Path) -> h5py.File:
    """Open an HDF5 file to read; InputError where it refers to values outside it.

    These are links to other files, and datasets whose values are in others, or virtual:
    nothing outside is touched. Raises what h5py raises, too.
    """
    file = h5py.File(os.fspath(path), "r", rdcc_nbytes=CACHE_BYTES)
    links: list[tuple[bytes, int]] = []
    try:
        file.id.links.visit(
            lambda name, info: links.append((name, info.type)), info=True
        )
        for name, kind in links:
            outside = kind not in (h5py.h5l.TYPE_HARD, h5py.h5l.TYPE_SOFT)
            if kind == h5py.h5l.TYPE_HARD and isinstance(
                node := file[name], h5py.Dataset
            ):
                outside = node.is_virtual or node.external is not None
            if outside:
                place = f"{path}:/{printable(name.decode('utf-8', 'replace'))}"
                fix = (
                    "copy the values into this file (h5repack, or h5py with"
                    " expand_external)"
                )
                raise input_error(
                    place, "has its values in another file or dataset", fix
                )
    except BaseException:
        file.close()
        raise
    return file


class Hdf5File:
    """An open HDF5 file; a context manager. Whatever is wrong is an InputError."""

    def __init__(self, path: Path) -> None:
        self.path = path
        # h5py takes long to look up their types and shapes
        self._datasets: dict[str, h5py.Dataset] = {}
        self._chunks: dict[str, SuspectChunks] = {}
        with self.damage_as_input_error():
            self.root = open_hdf5(path)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the file."""
        self._datasets.clear()
        self._chunks.clear()
        self.root.close()

    def place(self, name: str, row: int | None = None) -> str:
        """Return `path:/name[row]`, as messages name a dataset or group, or its row."""
        where = f"{self.path}:/{printable(name.strip('/'))}"
        return where if row is None else f"{where}[{row}]"

    def make_error(self, name: str, fault: str, fix: str = DAMAGED) -> InputError:
        """Return an InputError about a dataset or group; about the file for ""."""
        return input_error(self.place(name) if name else self.path, fault, fix)

    @contextmanager
    def damage_as_input_error(self, name: str = "") -> Iterator[None]:
        """Turn exceptions of h5py, by damage or missing filters, into InputError."""
        try:
            yield
        except (OSError, RuntimeError, LookupError, TypeError, ValueError) as error:
            reason = printable(str(error).partition("\n")[0])
            if isinstance(error, UnicodeError):
                reason = "text that is not UTF-8"
            filtered = "plugin" in reason.lower() or "required filter" in reason.lower()
            fix = (
                "write it again with gzip or without compression"
                if filtered
                else DAMAGED
            )
            raise self.make_error(name, f"cannot be read ({reason})", fix) from error

    def attribute(self, name: str, node: str = "/") -> Any:
        """Return an attribute as a Python str, bytes, number or list, None if absent.

        `node` is the group or dataset that has it.
        """
        with self.damage_as_input_error(node.strip("/")):
            attributes = self.root[node].attrs
            value = attributes[name] if name in attributes else None  # noqa: SIM401 hides damage
            if isinstance(value, str):
                value.encode()  # raises for what is not UTF-8
        if isinstance(value, h5py.Empty):
            return None
        if isinstance(value, np.ndarray):
            value = value.flat[0] if value.size == 1 else value.tolist()
        return value.item() if isinstance(value, np.generic) else value

    def has_dataset(self, name: str) -> bool:
        """Whether the file has a dataset of this name."""
        with self.damage_as_input_error(name):
            return isinstance(self.root.get(name), h5py.Dataset)

    def read_rows(self, name: str, rows: slice | tuple[()] = ()) -> Any:
        """Read rows of a dataset, `()` for all, in its stored type; texts become str.

        Raises InputError where there is no such dataset, and where its values are more
        than memory or the file can hold.
        """
        if name not in self._datasets and not self.has_dataset(name):
            raise self.make_error(name, "there is no such dataset")
        with self.damage_as_input_error(name):
            dataset = self._datasets.get(name) or self.root[name]
            shape: tuple[int, ...] = dataset.shape or ()
            width = dataset.dtype.itemsize
            text = h5py.check_string_dtype(dataset.dtype) is not None
            count = (
                len(range(shape[0])[rows])
                if isinstance(rows, slice)
                else math.prod(shape[:1])
            )
            value_bytes = max(2 * width, TEXT_BYTES if text else VALUE_BYTES)
            check_fits(self.place(name), count * math.prod(shape[1:]) * value_bytes)
            size = math.prod(shape) * width
            present = dataset.id.get_storage_size()
            if size > max(ALWAYS_FITS, MAX_COMPRESSION * present):
                total = format_bytes(size)
                fault = f"of its {total} the file holds {format_bytes(present)}"
                fix = "write its values, or make it smaller"
                raise self.make_error(name, fault, fix)
            if size and dataset.chunks and not present and not text:
                # HDF5 takes long, and gigabytes, to go through many chunks that are not
                # there
                return np.full((count, *shape[1:]), dataset.fillvalue, dataset.dtype)
            self._check_chunks(name, dataset, rows)
            values = dataset[rows]
            return _decode_texts(values) if text else values

    def _check_chunks(
        self, name: str, dataset: h5py.Dataset, rows: slice | tuple[()]
    ) -> None:
        """Raise InputError if chunks of these rows inflate to more than they declare.

        Chunks that memory cannot hold are refused, too.
        """
        if dataset.chunks is None:
            return
        if name not in self._chunks:
            self._chunks[name] = SuspectChunks(dataset)
        chunks = self._chunks[name]
        fix = "write it again with gzip or without compression"
        if chunks.fault:
            raise self.make_error(name, chunks.fault, fix)
        check_fits(self.place(name), chunks.bytes, "a chunk of it")
        start, stop = 0, len(dataset)
        if isinstance(rows, slice):
            start, stop, _ = rows.indices(stop)
        chunk = chunks.find_longer(start, stop)
        if chunk is not None:
            declared = format_bytes(chunks.bytes)
            fault = f"has a chunk that holds more than the {declared} that it declares"
            raise self.make_error(name, fault, fix)


def _decode_texts(stored: Any) -> Any:
    """Decode UTF-8: bytes to str, and an array of bytes to an array of str.

    It takes half the time of h5py's `asstr`.
    """
    if isinstance(stored, bytes):
        return stored.decode()
    texts = np.empty(stored.size, object)
    texts[:] = [*map(bytes.decode, stored.ravel().tolist())]
    return texts.reshape(stored.shape)


def as_text(value: Any) -> Any:
    """Decode an attribute if it is bytes; return any other value as it is."""
    return value.decode("utf-8", "replace") if isinstance(value, bytes) else value


def hdf5_kind(path: Path) -> str:
    """Return the kind of a shapefit file: landmarks, shapes, result or dictionary.

    It is that of the layout that the file says it has. Raises InputError for other
    files.
    """
    with Hdf5File(path) as file:
        return LAYOUTS[_check_format(file, *LAYOUTS)].kind


def _check_format(file: Hdf5File, *formats: str) -> str:
    """Return the root attribute `format`; InputError if it is none of `formats`."""
    stated = as_text(file.attribute("format"))
    if stated not in formats:
        fault, fix = f"is a {stated} file", f"give a {listed(formats)} file"
        if stated is None:
            fault = "has no root attribute format"
            fix += ", or one of DeepLabCut, SLEAP, JABS, NWB or movement"
        raise input_error(file.path, fault, fix)
    return str(stated)


class Seal(NamedTuple):
    """The digest of all that a result file holds: as stated in it, and as recomputed.

    An intact file has both alike. stated is "" where the file has none; rows are those
    of the input that are in the file, None for all.
    """

    stated: str
    found: str
    rows: tuple[int, int] | None


def read_seal(path: Path) -> Seal:
    """Return the digest that a result file states, and that of all its contents.

    Raises InputError where that cannot be.
    """
    with Hdf5File(path) as file:
        stated = str(as_text(file.attribute(CONTENTS)) or "")
        text = as_text(file.attribute(INPUT_ROWS))
        with file.damage_as_input_error():
            found = digest_contents(file.root, file.read_rows)
    rows = None
    if text is not None:
        numbers = re.fullmatch(r"(\d{1,18}):(\d{1,18})", str(text))
        if numbers is None:
            fault = f"has the root attribute {INPUT_ROWS} {printable(text)!r:.100}"
            raise input_error(path, fault, "the file was changed: fit again")
        rows = int(numbers[1]), int(numbers[2])
    return Seal(stated, found, rows)


class Hdf5Reader(Hdf5File):
    """An open HDF5 file of a known layout; a context manager.

    Opening checks layout and version, kind and shape of every dataset, and the landmark
    names; all else is read when asked for. With `old` results and dictionaries of
    version 1 are read, too. Raises InputError that names file and dataset for whatever
    is wrong.
    """

    def __init__(self, path: Path, layout: Layout, *, old: bool = False) -> None:
        super().__init__(path)
        self.layout = layout
        self.columns = dict(layout.columns)
        self._sizes: dict[str, int] = {}
        try:
            self._attributes = self._read_attributes(old)
            self._open_datasets()
            if not self._has_landmark_edges():
                self.columns.pop(EDGES, None)
            if problems := list(self._find_problems()):
                raise input_problems(problems)
            self.count = self._sizes.get("n", 0)
            names = self.read("landmark_names")
            if "" in names or len({*names}) < len(names):
                fault = "holds an empty name, or one twice"
                raise self.make_error(
                    "landmark_names", fault, "give every landmark a unique name"
                )
        except BaseException:
            self.close()
            raise

    @property
    def attributes(self) -> dict[str, Attribute]:
        """Root attributes, by name, that the layout does not define."""
        return {
            name.removeprefix(PREFIX): value
            for name, value in self._attributes.items()
            if name not in PLAIN_ATTRIBUTES and isinstance(value, str | int | float)
        }

    @property
    def unit(self) -> str:
        """The unit of lengths."""
        return str(self._attributes.get("unit", UNKNOWN_UNIT))

    @property
    def y_axis(self) -> Direction | None:
        """Where y points, `up` or `down`; None where the file does not say it.

        Raises InputError for other texts.
        """
        y_axis = self._attributes.get("y_axis")
        if y_axis == "up":
            return "up"
        if y_axis == "down":
            return "down"
        if y_axis is None:
            return None
        raise self._misstated_attribute()

    @property
    def frame_rate(self) -> float | None:
        """Frames per second, None where the file does not say it.

        Raises InputError for what is no such number.
        """
        rate = self._attributes.get("frame_rate")
        if rate is None:
            return None
        if isinstance(rate, int | float) and 0 < rate < math.inf:
            return float(rate)
        raise self._misstated_attribute()

    def _misstated_attribute(self) -> InputError:
        """Return the InputError for an invalid y_axis or frame_rate."""
        y_axis = self._attributes.get("y_axis")
        rate = self._attributes.get("frame_rate")
        fault = f"has the root attributes y_axis {y_axis!r} and frame_rate {rate!r}"
        fix = "set y_axis to up or down, and frame_rate to frames per second, a"
        return input_error(self.path, fault, f"{fix} number > 0")

    def read_record(self, rows: slice, without: Collection[str] = ()) -> Items:
        """Read these rows as a record, without the datasets named in `without`."""
        assert self.layout.record is not None, "a dictionary has no items"
        fields: dict[str, Any] = {}
        extras: dict[str, Array] = {}
        file_extras: dict[str, Array] = {}
        for name in sorted(self._datasets.keys() - {*without}):
            values = self.read(name, rows)
            if name in self.columns:
                fields[self.columns[name].field] = values
            elif self._is_per_item(name):
                extras[self._name_of_extra(name)] = values
            else:
                file_extras[self._name_of_extra(name)] = values
        if self.layout is RESULTS:
            fields["attributes"] = self.attributes
        if self.layout is not SHAPES:
            fields["y_axis"] = self.y_axis or "down"
        return self.layout.record(
            **fields,
            unit=self.unit,
            frame_rate=self.frame_rate,
            extras=extras,
            file_extras=file_extras,
        )

    def _name_of_extra(self, name: str) -> str:
        """Return the name for an extra, `input_name` if a field's column has `name`."""
        return f"input_{name}" if name in self.layout.columns else name

    def dictionary_fields(self) -> dict[str, Any]:
        """Return field -> value for the datasets of a dictionary, None if absent.

        Points are in the orientation of the mathematics, (..., 3, p).
        """
        fields: dict[str, Any] = {}
        for name, column in self.columns.items():
            values = self.read(name) if name in self._datasets else None
            if values is not None and name in DICTIONARY_POINTS:
                values = np.ascontiguousarray(values.swapaxes(-1, -2))
            fields[column.field] = values
        return fields

    def read(self, name: str, rows: slice = slice(None)) -> Any:
        """Read a dataset; of one that is per item only the items in `rows`.

        What the layout lists has the type of its field, all else its stored type.
        Raises InputError for values of another type.
        """
        column = self.columns.get(name)
        if column and column.axes[0] == "a":
            start, stop, _ = rows.indices(self.count)
            bounds = self._transform_bounds
            rows = slice(int(bounds[start]), int(bounds[max(start, stop)]))
        per_item = self._is_per_item(name)
        values = np.asarray(self.read_rows(name, rows if per_item else ()))
        if column is None:
            return values
        if column.kind == Texts:
            return all_composed(values)
        try:
            return as_kind(column, values)
        except ValueError:
            fault = f"holds other values than {column.noun}"
            raise self.make_error(name, fault, f"store {column.noun}") from None

    @cached_property
    def _transform_bounds(self) -> Integers:
        """The first row (n + 1,) of each item's transforms, and the number of rows.

        Raises InputError where their counts are not those of the rows.
        """
        counts = self.read(COUNTS)
        ends = np.cumsum([0, *counts])
        total = self._sizes.get("a", 0)
        # none is more than all, lest a sum of large ones overflows to the right one
        if ((counts < 0) | (counts > total)).any() or ends[-1] != total:
            fault = f"does not count the {total} rows of transforms"
            raise self.make_error(COUNTS, fault, "the file was changed: fit again")
        return ends

    def _read_attributes(self, old: bool) -> dict[str, Any]:
        """Check format and version, and return the root attributes by name."""
        _check_format(self, self.layout.name)
        with self.damage_as_input_error():
            names = list(self.root.attrs)
        root = {name: as_text(self.attribute(name)) for name in names}
        version = root.get("version")
        if version == 1 and not old and self.layout in (RESULTS, DICTIONARY):
            fix = f"write it anew: shapefit convert {self.path.name} -o NEW.h5"
            raise input_error(self.path, "is of version 1, an earlier format", fix)
        if version not in (1, VERSION):
            fix = f"this program reads version {VERSION}, a number"
            raise input_error(
                self.path, f"has the root attribute version {version!r}", fix
            )
        return root

    def _open_datasets(self) -> None:
        """Open all datasets, by their names in version 2 if version 1 had others."""
        nodes: dict[str, h5py.Group | h5py.Dataset] = {}
        with self.damage_as_input_error():
            self.root.visititems(
                lambda name, node: nodes.update({name: node})
            )  # no soft links
            nodes |= {
                name: self.root[name] for name in self.columns if name in self.root
            }
            if not all(isinstance(name, str) for name in nodes):
                raise ValueError("a name is not UTF-8")
        renamed = RENAMED if self._attributes["version"] == 1 else {}
        for name, node in nodes.items():
            if not isinstance(node, h5py.Dataset):
                continue
            # one of the null dataspace holds nothing that could be carried along
            if node.shape is not None or name in self.columns:
                self._datasets[renamed.get(name, name)] = node

    def _has_landmark_edges(self) -> bool:
        """Whether the dataset `edges`, if any, holds edges between landmarks.

        Landmarks and results of other tools may carry something else under this name.
        """
        if self.layout in (SHAPES, DICTIONARY) or EDGES not in self._datasets:
            return True
        edges = self._datasets[EDGES]
        return (edges.shape or ())[1:] == (2,) and edges.dtype.kind in "iu"

    def _find_problems(self) -> Iterator[str]:
        """Yield a message for each dataset that is absent or of wrong kind or shape."""
        for name, column in self.columns.items():
            letters, values = _allowed_kinds(column)
            fault = "there is no such dataset" if column.required else ""
            if name in self._datasets:
                dataset = self._datasets[name]
                text = h5py.check_string_dtype(dataset.dtype) is not None
                kind = "O" if text else dataset.dtype.kind.replace("O", "?")
                fits = match_axes(column.axes, dataset.shape or (), self._sizes)
                what = f"{'text' if text else dataset.dtype} {dataset.shape}"
                fault = "" if fits and kind in letters else f"holds {what}"
            if column.axes[0] == "a" and COUNTS not in self._datasets and not fault:
                counted = name in self._datasets
                fault = f"{COUNTS}, which counts its rows, is absent" if counted else ""
            if fault:
                axes = tuple(self._sizes.get(str(axis), axis) for axis in column.axes)
                wanted = f"store {values} {axes}".replace("'", "")
                yield f"{self.place(name)}: {fault}; {wanted}"

    def _is_per_item(self, name: str) -> bool:
        """Whether a dataset has a row for each item.

        By its layout, else by its attribute in version 2, and its axes in version 1.
        """
        if name in self.columns:
            return self.columns[name].per_item
        dataset = self._datasets[name]
        if self._attributes["version"] == 1:
            per_item = self.layout.is_per_item(name, dataset.ndim)
        else:
            with self.damage_as_input_error(name):
                per_item = bool(dataset.attrs.get(PER_ITEM, False))
        return per_item and bool(dataset.shape[:1] == (self.count,))


def _allowed_kinds(column: Column) -> tuple[str, str]:
    """Return letters of NumPy's kinds that a column may have, and words for them."""
    if column.is_text:
        return TEXT
    return INTEGERS if column.is_integer else NUMBER_KINDS
