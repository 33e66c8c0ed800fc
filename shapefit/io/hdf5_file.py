"""An open HDF5 file, ours or of others: what is wrong is an error that names file and dataset."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from math import prod
from pathlib import Path
from typing import Any, NamedTuple, Self

import h5py
import numpy as np

from shapefit.errors import InputError, input_error, printable
from shapefit.io.inputs import ALWAYS_FITS, check_fits, in_words

DAMAGED = "the file may be cut off or damaged: copy or make it again"
ELSEWHERE = "has its values in another file or dataset"
COPY_FIX = "copy the values into this file (h5repack, or h5py's copy with expand_external)"

VALUE_BYTES, TEXT_BYTES = 16, 100
"""Bytes of memory for a number and its copy, and for a short text, while they are read."""

CACHE_BYTES = 1 << 20
"""Of chunks that are kept for each dataset; by default HDF5 keeps 8 MB, and rows are read once."""

MOST_COMPRESSED = 2000
"""No filter of HDF5 makes data smaller by more: beyond that they were never written."""


def open_hdf5(path: Path) -> h5py.File:
    """Open a file to read.

    Raises what h5py raises, and InputError for pipes, and for files that hold links to others,
    datasets whose values are in others, and virtual datasets: nothing outside is touched.
    """
    if path.is_fifo():  # opening it would wait for whoever writes
        raise input_error(path, "is a pipe, and HDF5 cannot come through one", "save it to a file")
    file = h5py.File(os.fspath(path), "r", rdcc_nbytes=CACHE_BYTES)
    links: list[tuple[bytes, int]] = []
    try:
        file.id.links.visit(lambda name, info: links.append((name, info.type)), info=True)
        for name, kind in links:
            outside = kind not in (h5py.h5l.TYPE_HARD, h5py.h5l.TYPE_SOFT)
            node = h5py.h5o.open(file.id, name) if kind == h5py.h5l.TYPE_HARD else None
            if isinstance(node, h5py.h5d.DatasetID):
                creation = node.get_create_plist()
                virtual = creation.get_layout() == h5py.h5d.VIRTUAL
                outside = virtual or creation.get_external_count() > 0
            if outside:
                place = f"{path}:/{printable(name.decode('utf-8', 'replace'))}"
                raise input_error(place, ELSEWHERE, COPY_FIX)
    except BaseException:
        file.close()
        raise
    return file


class Stored(NamedTuple):
    """A dataset, whether it holds text, and its shape, which h5py takes long to look up."""

    dataset: Any
    text: bool
    shape: tuple[int, ...]


class Hdf5File:
    """An open HDF5 file; a context manager. Whatever is wrong is an InputError."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._datasets: dict[str, Stored] = {}
        with self.damage():
            self.root = open_hdf5(path)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the file."""
        self._datasets.clear()
        self.root.close()

    def place(self, name: str, row: int | None = None) -> str:
        """Name a dataset or group, or a row of it, in messages."""
        where = f"{self.path}:/{printable(name.strip('/'))}"
        return where if row is None else f"{where}[{row}]"

    def fault(self, name: str, fault: str, fix: str = DAMAGED) -> InputError:
        """Return the error for what is wrong with a dataset or group."""
        return input_error(self.place(name), fault, fix)

    @contextmanager
    def damage(self, name: str = "") -> Iterator[None]:
        """Turn what h5py raises for damaged files, and for filters it lacks, into an InputError."""
        try:
            yield
        except (OSError, RuntimeError, LookupError, TypeError, ValueError) as error:
            reason = printable(str(error).partition("\n")[0])
            fault, fix = f"cannot be read ({reason})", DAMAGED
            if "plugin" in reason.lower() or "required filter" in reason.lower():
                fault = f"is compressed in a way that is not built in here ({reason})"
                fix = "write it again with gzip or without compression"
            raise input_error(self.place(name) if name else self.path, fault, fix) from error

    def attribute(self, name: str, node: str = "/") -> Any:
        """Return an attribute as Python's own str, bytes, number or list; None without it."""
        with self.damage(node.strip("/")):
            attributes = self.root[node].attrs
            value = attributes[name] if name in attributes else None  # noqa: SIM401
            if isinstance(value, str):
                value.encode()  # raises for what is not UTF-8
        if value is None or isinstance(value, h5py.Empty):
            return None
        if isinstance(value, np.ndarray):
            value = value.flat[0] if value.size == 1 else value.tolist()
        return value.item() if isinstance(value, np.generic) else value

    def is_dataset(self, name: str) -> bool:
        """Whether there is such a dataset."""
        with self.damage(name):
            return isinstance(self.root.get(name), h5py.Dataset)

    def stored(self, name: str) -> Stored:
        """Return a dataset, and what every read wants to know of it."""
        if name not in self._datasets:
            if not self.is_dataset(name):
                raise self.fault(name, "there is no such dataset")
            with self.damage(name):
                dataset = self.root[name]
                text = h5py.check_string_dtype(dataset.dtype) is not None
                self._datasets[name] = Stored(dataset, text, dataset.shape or ())
        return self._datasets[name]

    def rows(self, name: str, rows: slice | tuple[Any, ...] = ()) -> Any:
        """Return rows of a dataset as they stand in the file, texts as str; `()` is all of it.

        Raises InputError where they are more than memory or the file can hold.
        """
        dataset, text, shape = self.stored(name)
        count = len(range(shape[0])[rows]) if isinstance(rows, slice) else prod(shape[:1])
        with self.damage(name):
            value_bytes = TEXT_BYTES if text else max(2 * dataset.dtype.itemsize, VALUE_BYTES)
            check_fits(self.place(name), count * prod(shape[1:]) * value_bytes)
            size = prod(shape) * dataset.dtype.itemsize
            present = dataset.id.get_storage_size() if size > ALWAYS_FITS else size
            if size > MOST_COMPRESSED * present:
                fault = f"of its {in_words(size)} the file holds {in_words(present)}"
                raise self.fault(name, fault, "write its values, or make it smaller")
            if size and not text and dataset.chunks and not dataset.id.get_storage_size():
                # HDF5 takes long, and gigabytes, to go through many chunks that are not there
                return np.full((count, *shape[1:]), dataset.fillvalue, dataset.dtype)
            values = dataset[rows]
            return _decoded(values) if text else values


def _decoded(stored: Any) -> Any:
    """Return bytes as str, an array of them as an array; in half the time of h5py's `asstr`."""
    if isinstance(stored, bytes):
        return stored.decode()
    texts = np.empty(stored.size, object)
    texts[:] = [*map(bytes.decode, stored.ravel().tolist())]
    return texts.reshape(stored.shape)


def as_text(value: Any) -> Any:
    """Return an attribute, bytes as text."""
    return value.decode("utf-8", "replace") if isinstance(value, bytes) else value
