"""An open file of one of our layouts, whatever its format: what all readers share."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, Self

import numpy as np

from shapefit.errors import input_error
from shapefit.io.layout import (
    AXES,
    FURTHER_OF_RESULTS,
    PLAIN_ATTRIBUTES,
    RESULTS,
    UNKNOWN_UNIT,
    VERSION,
    Dataset,
    Layout,
    fit_axes,
    fits_kind,
    plain_name,
)
from shapefit.io.memory import check_fits

BLOCK, BLOCK_BYTES = 16384, 1 << 24
"""Most items, and most bytes of them, that a check reads at a time."""


class StoredReader(ABC):
    """An open file of a known layout; a context manager.

    Opening checks the layout and its version, and the kind and shape of every dataset, and reads
    the landmark names; all else is read when asked for. Whatever the file does wrong is an
    InputError that names file and dataset.
    """

    ATTRIBUTE = "attribute"
    """What a format calls the place of unit, y_axis and the like."""

    landmark_names: tuple[str, ...]

    def __init__(self, path: Path, form: Layout) -> None:
        self.path = path
        self.form = form
        self._root: dict[str, Any] = {}
        self._sizes: dict[str, int] = {}
        self._present: set[str] = set()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None:
        self.close()

    @abstractmethod
    def close(self) -> None:
        """Let go of the file."""

    @abstractmethod
    def place(self, name: str, row: int | None = None) -> str:
        """Name a dataset, or a row of it, in messages."""

    @abstractmethod
    def is_written(self, name: str) -> bool:
        """Whether anything was ever written to a dataset."""

    @property
    def groups(self) -> Sequence[int]:
        """First rows of what is decoded as one; none where any row can be read by itself."""
        return ()

    @property
    @abstractmethod
    def names(self) -> frozenset[str]:
        """Names of all datasets of the file."""

    @property
    @abstractmethod
    def _extra_names(self) -> tuple[list[str], list[str]]:
        """Names of the datasets that the layout does not know: per item, and whole."""

    @abstractmethod
    def _values(self, name: str, rows: slice | tuple[()]) -> Any:
        """Return these rows of a dataset as they stand in the file, texts as str.

        `()` is all of it. Rows of what another dataset counts are those of these items.
        """

    @abstractmethod
    def _bytes(self, name: str, rows: slice | tuple[()]) -> int:
        """Bytes that these rows of a dataset take in memory while they are read."""

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
        found = f"the {self.ATTRIBUTE} y_axis is '{direction}'"
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
        found = f"the {self.ATTRIBUTE} frame_rate is {rate!r}"
        raise input_error(
            self.path, found, "set it to frames per second, a number > 0, or remove it"
        )

    def has(self, name: str) -> bool:
        """Whether the file has this dataset of its layout."""
        return name in self._present

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
        dataset = next(known for known in self.form.datasets if known.name == name)
        if not self.has(name) or (dataset.counted_by and not self.has(dataset.counted_by)):
            return None
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
        start, stop, _ = (part or slice(None)).indices(self.count)
        most = max(1, min(BLOCK, stop - start))
        # Of many rows at once: a chunk of the file is counted with them, however few they are.
        taken = self._bytes(name, slice(start, start + most))
        rows = max(1, min(most, most * BLOCK_BYTES // max(taken, 1)))
        return (
            self.read(name, slice(row, min(row + rows, stop))) for row in range(start, stop, rows)
        )

    def fields(
        self, rows: slice = slice(None), *, without: Collection[Dataset] = ()
    ) -> dict[str, Any]:
        """Return what the datasets of the layout hold of these items, by field of the record.

        Those in `without` are not read.
        """
        chosen = {
            dataset: rows if dataset.grows else slice(None)
            for dataset in self.form.datasets
            if dataset not in without
        }
        self._check_fits({dataset.name: part for dataset, part in chosen.items()})
        return {dataset.attribute: self.read(dataset.name, chosen[dataset]) for dataset in chosen}

    def further(self, rows: slice = slice(None)) -> dict[str, Any]:
        """Return these rows of the datasets that the layout does not know, as records take them.

        Raises InputError for those of a result that are not as a fit writes them.
        """
        per_item, whole = self._extra_names
        self._check_fits(dict.fromkeys(per_item, rows) | dict.fromkeys(whole, ()))
        columns = {name: self._values(name, rows) for name in per_item}
        columns |= {name: np.asarray(self._values(name, ())) for name in whole}
        if self.form == RESULTS:
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
                fix = f"{wanted(dataset)}, or remove it"
                raise input_error(self.place(dataset.name), found, fix)

    def _check_fits(self, chosen: Mapping[str, slice | tuple[()]]) -> None:
        """Raise InputError where these rows of datasets are more than memory holds."""
        sizes = {
            name: self._bytes(name, rows)
            for name, rows in chosen.items()
            if self.has(name) or name not in self.form.names
        }
        largest = max(sizes, key=lambda name: sizes[name], default="")
        check_fits(self.place(largest), sum(sizes.values()), "with the other datasets it")

    def _check_version(self) -> None:
        version = self._root.get("version")
        if version == VERSION:
            return
        said = f"has no {self.ATTRIBUTE} version" if version is None else f"has version {version}"
        fix = f"this program reads version {VERSION}"
        if isinstance(version, str):
            said, fix = f"has the version '{version}' as text", f"store the number {VERSION}"
        raise input_error(self.path, said, fix)

    def _check_texts(self) -> None:
        """Raise InputError for an attribute that no file of ours could hold."""
        for name, value in self._root.items():
            if isinstance(value, str) and not is_text(value):
                place, fix = f"{self.path}: {self.ATTRIBUTE} {name}", "write it as UTF-8"
                raise input_error(place, "is not UTF-8 text, or has a zero byte", fix)

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


def is_text(text: str) -> bool:
    """Whether files can hold a text: h5py and JSON have lone surrogates for what is not UTF-8."""
    return not any("\ud800" <= letter <= "\udfff" or letter == "\0" for letter in text)


def wanted(dataset: Dataset) -> str:
    """Say how to store a dataset: `store numbers (items, landmarks, 3)`."""
    kinds = {"number": "numbers", "index": "integers", "text": "UTF-8 text", "label": "UTF-8 text"}
    axes = ", ".join(AXES.get(str(axis), str(axis)) for axis in dataset.axes)
    return f"store {kinds[dataset.kind]} ({axes})"
