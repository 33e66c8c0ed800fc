"""Our own HDF5 files, read: datasets by their layout, checked."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Collection, Mapping
from functools import cached_property
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from shapefit.arrays import Integers
from shapefit.errors import abbreviate, input_error, printable
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
    plain_name,
)
from shapefit.io.records import KINDS, Attribute

CACHE_BYTES = 1 << 20
"""Of chunks that are kept for each dataset; by default HDF5 keeps 8 MB, and rows are read once."""

OTHER_TOOLS = "DeepLabCut, SLEAP, JABS, NWB (the attribute nwb_version) or movement (ds_type)"
"""The HDF5 files of other tools that are read."""

NUMPY_KINDS = {"number": "biuf", "index": "iu", "text": "O", "label": "Oiu"}
"""Types of NumPy that the kinds of datasets can have in files, O for text."""

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
            self._root = self._read_root(old)
            self._stored = self._find_datasets()
            self._check_datasets()
            self.landmark_names = self._check_landmark_names(self.read("landmark_names"))
        except BaseException:
            self.close()
            raise

    @property
    def count(self) -> int:
        """Number of items."""
        return self._sizes["n"]

    @property
    def unit(self) -> str:
        """Unit of lengths, as the file states it."""
        return str(self._root.get("unit", UNKNOWN_UNIT))

    @property
    def attributes(self) -> dict[str, Attribute]:
        """Attributes that the layout does not define: texts and numbers."""
        return {
            plain_name(name): value
            for name, value in self._root.items()
            if name not in PLAIN_ATTRIBUTES and isinstance(value, str | int | float)
        }

    @property
    def y_axis(self) -> Any:
        """Whether y points up or down, where the file says it. Raises InputError for another."""
        direction = self._root.get("y_axis")
        if direction in (None, "up", "down"):
            return direction
        found = f"the root attribute y_axis is '{direction}'"
        raise input_error(self.path, found, "set it to up or down")

    @property
    def frame_rate(self) -> float | None:
        """Frames a second; None where the file states none. Raises InputError unless it is > 0."""
        rate = self._root.get("frame_rate")
        if rate is None:
            return None
        if isinstance(rate, int | float) and not isinstance(rate, bool) and 0 < rate < math.inf:
            return float(rate)
        found = f"the root attribute frame_rate is {rate!r}"
        fix = "set it to frames per second, a number > 0, or remove it"
        raise input_error(self.path, found, fix)

    def records(self, rows: slice, without: Collection[str] = ()) -> Any:
        """Return the items in these rows, without some datasets."""
        kind: Any = KINDS[self.form.kind]
        per_item, whole = self._further
        return kind(
            **self.fields(rows, without),
            columns={name: self._values(name, rows) for name in per_item if name not in without},
            whole={name: np.asarray(self._values(name)) for name in whole if name not in without},
            unit=self.unit,
            frame_rate=self.frame_rate,
            y_axis=None if self.form.kind == "shapes" else self.y_axis or "down",
            attributes=self.attributes if self.form.kind == "result" else None,
        )

    def larger_further(self, size: int) -> set[str]:
        """Return the datasets that the layout does not know, and vertices, of more bytes."""
        names = self._stored.keys() - self.form.names | {"mesh_vertices"} & self._stored.keys()
        stored = ((name, self.stored(self._stored[name])) for name in names)
        return {name for name, each in stored if math.prod(each.shape) * each.itemsize > size}

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
        if not {name, column.counted_by or name} <= self._stored.keys():
            return None
        values = self._values(name, self._rows_of(name, column, rows))
        if column.kind == "text":
            return tuple(values)
        if column.kind == "label":
            return values.astype(str) if values.dtype.kind == "O" else values
        with np.errstate(invalid="ignore", over="ignore"):  # nan and inf are found by the checks
            array = np.asarray(values, np.int64 if column.kind == "index" else np.float64)
        return np.ascontiguousarray(array.swapaxes(-1, -2)) if column.points else array

    @cached_property
    def _further(self) -> tuple[list[str], list[str]]:
        """Names of the datasets that the layout does not know: per item, and of the file."""
        per_item: list[str] = []
        whole: list[str] = []
        for name in self._stored.keys() - self.form.names:
            stored, column = self.stored(self._stored[name]), self.form.further.get(name)
            with self.damage(name):
                flag = stored.dataset.attrs.get(PER_ITEM)
            if column is not None:
                flag = column.per_item
            elif flag is None and self._root["version"] < VERSION:
                flag = self.form.is_per_item(name, len(stored.shape))
                flag = flag and stored.shape[:1] == (self.count,)
            if flag and stored.shape[:1] != (self.count,):
                found = f"has the shape {stored.shape}, and says that it is per item"
                raise self.fault(name, found, f"store a row for each of {self.count} items")
            (per_item if flag else whole).append(name)
        return sorted(per_item), sorted(whole)

    def _values(self, name: str, rows: slice | tuple[()] = ()) -> Any:
        name = self._stored[name]
        values = self.rows(name, rows)
        if self.stored(name).text and "\0" in "".join(np.ravel(values)):
            raise self.fault(name, "holds a string with a zero byte", "remove it")
        return values

    def _rows_of(self, name: str, column: Column, items: slice) -> slice | tuple[()]:
        """Return the rows that items have in a dataset: other ones where it is counted."""
        if not column.counted_by:
            return items if column.per_item else ()
        if name not in self._ends:
            self._ends[name] = self._added_up(name, column)
        ends = self._ends[name]
        start, stop, _ = items.indices(self.count)
        return slice(int(ends[start]), int(ends[max(start, stop)]))

    def _added_up(self, name: str, column: Column) -> Integers:
        """Return where the rows of each item begin, and the last ends (n + 1,)."""
        counts: Integers = self.read(column.counted_by)
        axis = str(column.axes[0])
        length = self._sizes.get(axis, 0)
        most = (self._sizes.get("k") if axis == "a" else None) or length
        wrong = np.flatnonzero((counts < 0) | (counts > most))
        if len(wrong):
            found = f"is {counts[wrong[0]]}, not a number of {AXES[axis]}"
            raise input_error(self.place(column.counted_by, int(wrong[0])), found, CHANGED)
        ends: Integers = np.concatenate([[0], np.cumsum(counts)])
        if ends[-1] != length:
            found = f"holds {length} {AXES[axis]}, and {column.counted_by} counts {ends[-1]}"
            raise input_error(self.place(name), found, CHANGED)
        return ends

    def _read_root(self, old: bool) -> dict[str, Any]:
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
        version, known = root.get("version"), [VERSION, *([1] if old else self.form.old_versions)]
        if version == 1 and version not in known:
            fix = f"write it anew: shapefit convert {self.path.name} -o NEW.h5"
            raise input_error(self.path, "is of version 1, an earlier format", fix)
        if version not in known or isinstance(version, bool):
            fix = f"this program reads version {VERSION}, a number"
            raise input_error(self.path, f"has the root attribute version {version!r}", fix)
        if root.pop(DIGEST, digest_of(root)) != digest_of(root):
            fix = (
                f"if the change was meant, remove the attribute {DIGEST}; else copy the file again"
            )
            raise input_error(self.path, "a root attribute was changed or damaged", fix)
        return root

    def _find_datasets(self) -> dict[str, str]:
        """Return where each dataset lies, by its name of today."""
        found: list[Any] = []
        with self.damage():
            self.root.visititems(lambda name, node: found.append((name, node)))  # but no soft links
            own = {name for name, _ in found}
            found += [
                (name, self.root[name]) for name in self.form.all.keys() - own if name in self.root
            ]
        stored: dict[str, str] = {}
        for name, node in found:
            if not isinstance(name, str) or not _is_utf8(name):
                strange = f"there is a name that is not plain UTF-8: {printable(name)}"
                raise input_error(self.path, strange, "rename it or remove it")
            if not isinstance(node, h5py.Dataset):
                if name in self.form.all:
                    wanted = _wanted(self.form.all[name])
                    raise self.fault(name, "is not a dataset", wanted)
                continue
            with self.damage(name):
                carried = node.shape is not None and _kind(node) in (*"biufc", "O")
            if not carried and name not in self.form.all:
                raise self.fault(name, "cannot be carried over", "store numbers or text")
            old = self._root["version"] < VERSION
            stored[RENAMED.get(name, name) if old else name] = name
        return stored

    def _check_datasets(self) -> None:
        """Raise InputError for datasets of another kind or shape than the layout has."""
        problems = []
        for name, column in self.form.all.items():
            wrong = ""
            if name in self._stored:
                with self.damage(name):
                    node = self.root[self._stored[name]]
                    wrong = _wrong_kind(node, column) or self._wrong_shape(node, column)
            elif column.required:
                wrong = f"there is no such dataset; {_wanted(column)}"
            if wrong:
                problems.append(f"{self.place(name)}: {wrong}")
        if problems:
            raise input_problems(problems)

    def _wrong_shape(self, node: Any, column: Column) -> str:
        shape = node.shape or ()
        if fit_axes(column.axes, shape, self._sizes):
            return ""
        sizes = ", ".join(str(self._sizes.get(str(axis), axis)) for axis in column.axes)
        return f"has the shape {shape}; {_wanted(column)}, here ({sizes})"

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


def _wanted(column: Column) -> str:
    """Say how to store a dataset: `store numbers (items, landmarks, 3)`."""
    kinds = {"number": "numbers", "index": "integers", "text": "UTF-8 text", "label": "UTF-8 text"}
    axes = ", ".join(AXES.get(str(axis), str(axis)) for axis in column.axes)
    return f"store {kinds[column.kind]} ({axes})"


def _wrong_kind(node: Any, column: Column) -> str:
    kind = _kind(node)
    if kind and kind in NUMPY_KINDS[column.kind]:
        return ""
    return f"holds values of type {'text' if kind == 'O' else node.dtype}; {_wanted(column)}"


def _kind(dataset: Any) -> str:
    """Return the kind of NumPy of a dataset: O for text, and "" for other objects."""
    if h5py.check_string_dtype(dataset.dtype) is not None:
        return "O"
    return str(dataset.dtype.kind).replace("O", "")


def _is_utf8(text: str) -> bool:
    """Whether files can hold a text: h5py and JSON have lone surrogates for what is not UTF-8."""
    return not any("\ud800" <= letter <= "\udfff" or letter == "\0" for letter in text)
