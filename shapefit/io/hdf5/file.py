"""An open HDF5 file, ours or of others: what is wrong is an error that names file and dataset."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import product
from math import prod
from pathlib import Path
from typing import Any, Self

import h5py
import numpy as np
from numpy.typing import NDArray

from shapefit.errors import InputError, input_error, printable
from shapefit.io.hdf5.opening import open_hdf5
from shapefit.io.memory import ALWAYS_FITS, check_fits, in_words

DAMAGED = "the file may be cut off or damaged: copy or make it again"
FILTERS = ("plugin", "required filter")
"""Words of HDF5 about a compression that it does not have."""


class Hdf5File:
    """An open HDF5 file; a context manager. Whatever is wrong is an InputError."""

    def __init__(self, path: Path, cache_bytes: int | None = None) -> None:
        self.path = path
        self._asked: dict[str, Stored] = {}
        with self.damage():
            self.root = open_hdf5(path, cache_bytes)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the file."""
        self._asked.clear()
        self.root.close()

    def place(self, name: str, row: int | None = None) -> str:
        """Name a dataset or group, or a row of it, in messages."""
        name = name.strip("/")
        where = f"{self.path}:/{name if name.isprintable() else printable(name)}"
        return where + ("" if row is None else f"[{row}]")

    def fault(self, name: str, found: str, fix: str = DAMAGED) -> InputError:
        """Return the error for what is wrong with a dataset or group."""
        return input_error(self.place(name), found, fix)

    @contextmanager
    def damage(self, name: str = "") -> Iterator[None]:
        """Turn what h5py raises for damaged files, and for filters it lacks, into an InputError."""
        try:
            yield
        except (OSError, RuntimeError, LookupError, TypeError, ValueError) as error:
            place = self.place(name) if name else str(self.path)
            if isinstance(error, UnicodeDecodeError):
                fix = "write its strings as UTF-8"
                raise input_error(place, "holds text that is not UTF-8", fix) from error
            reason = printable(str(error).partition("\n")[0])
            if any(words in reason.lower() for words in FILTERS):
                found = f"is compressed in a way that is not built in here ({reason})"
                fix = "write it again with gzip or without compression"
                raise input_error(place, found, fix) from error
            raise input_error(place, f"cannot be read ({reason})", DAMAGED) from error

    def attribute(self, name: str, node: str = "/") -> Any:
        """Return an attribute as Python's own str, bytes, number or list; None without it."""
        with self.damage(node.strip("/")):
            attributes = self.root[node].attrs
            value = attributes[name] if name in attributes else None  # noqa: SIM401
        if value is None or isinstance(value, h5py.Empty):
            return None
        if isinstance(value, np.ndarray):
            value = value.flat[0] if value.size == 1 else value.tolist()
        return value.item() if isinstance(value, np.generic) else value

    def is_dataset(self, name: str) -> bool:
        """Whether there is such a dataset."""
        with self.damage(name):
            return name in self._asked or isinstance(self.root.get(name), h5py.Dataset)

    def stored(self, name: str) -> Stored:
        """Return a dataset, and what every read wants to know of it."""
        if not self.is_dataset(name):
            raise self.fault(name, "there is no such dataset")
        with self.damage(name):
            if name not in self._asked:
                self._asked[name] = Stored.of(self.root[name])
            return self._asked[name]

    def size(self, name: str, rows: slice | tuple[()]) -> int:
        """Bytes that these rows of a dataset take while they are read."""
        stored = self.stored(name)
        with self.damage(name):
            return size_in_memory(stored, rows)

    def rows(self, name: str, rows: slice | tuple[Any, ...] = ()) -> Any:
        """Return rows of a dataset as they stand in the file, texts as str; `()` is all of it."""
        stored = self.stored(name)
        whole = rows if isinstance(rows, slice) or rows == () else ()
        size = self.size(name, whole)
        check_fits(self.place(name), size)
        if size > ALWAYS_FITS:
            self.check_written(name)
        with self.damage(name):
            return read_rows(stored, rows) if whole is rows else stored.dataset[rows]

    def check_written(self, name: str) -> None:
        """Raise InputError for a large dataset that takes next to no place in the file."""
        with self.damage(name):
            dataset = self.stored(name).dataset
            size, there = dataset.nbytes, dataset.id.get_storage_size()
        if size > ALWAYS_FITS and size > MOST_COMPRESSED * there:
            found = f"of its {in_words(size)} the file holds {in_words(there)}"
            raise self.fault(name, found, "write its values, or make it smaller")


TEXT = 100
"""Bytes of a short text in memory, and of the place where it is held."""

COPIES = 2
"""Of what is read: as it stands in the file, and as the records have it."""


MOST_COMPRESSED = 2000
"""No filter of HDF5 makes data smaller by more: beyond that they were never written."""


@dataclass(frozen=True)
class Stored:
    """A dataset, and what h5py takes long to say of it, and every read wants to know."""

    dataset: Any
    text: bool
    shape: tuple[int, ...]
    chunks: tuple[int, ...] | None
    itemsize: int

    @classmethod
    def of(cls, dataset: Any) -> Self:
        """Ask a dataset once."""
        kind = dataset.dtype
        text = h5py.check_string_dtype(kind) is not None
        return cls(dataset, text, dataset.shape or (), dataset.chunks, kind.itemsize)


def size_in_memory(stored: Stored, rows: slice | tuple[()]) -> int:
    """Bytes that these rows of a dataset take while they are read, with a chunk of the file."""
    shape = stored.shape
    if shape and isinstance(rows, slice):
        shape = (len(range(*rows.indices(shape[0]))), *shape[1:])
    entry = TEXT if stored.text else COPIES * max(stored.itemsize, 8)
    chunk = prod(stored.chunks or ()) * stored.itemsize if prod(shape) else 0
    return prod(shape) * entry + chunk


MOST_CHUNKS = 10_000
"""That are read at once: HDF5 takes some 6 kB for each, whatever it holds."""

MOST_AT_ONCE = 1_000_000
"""Chunks of rows that are wanted together: more take HDF5 ten seconds and up."""

Place = tuple[slice, ...]


def read_rows(stored: Stored, rows: slice | tuple[()]) -> Any:
    """Return these rows of a dataset, texts as str; `()` is all of it, a scalar too.

    Raises InputError where they lie in more chunks than `MOST_AT_ONCE`.
    """
    source, chunks, shape = stored.dataset, stored.chunks, stored.shape
    if not chunks or _count(shape, chunks) <= MOST_CHUNKS:
        return _texts(source[rows]) if stored.text else source[rows]
    start, stop, _ = (rows if isinstance(rows, slice) else slice(None)).indices(shape[0])
    wanted = (max(stop - start, 0), *shape[1:])
    if (count := _count(wanted, chunks)) > MOST_AT_ONCE:
        place = f"{stored.dataset.file.filename}:{stored.dataset.name}"
        raise input_error(place, f"lies in {count} chunks", "store it in larger ones")
    values: NDArray[Any] = np.empty(wanted, object if stored.text else stored.dataset.dtype)
    for piece in _pieces(wanted, chunks):
        first = piece[0]
        values[piece] = source[slice(start + first.start, start + first.stop), *piece[1:]]
    return _texts(values) if stored.text else values


def _texts(stored: Any) -> Any:
    """Return bytes as str, an array of them as an array; in half the time of h5py's `asstr`."""
    if isinstance(stored, bytes):
        return stored.decode()
    texts = np.empty(stored.size, object)
    texts[:] = [*map(bytes.decode, stored.ravel().tolist())]
    return texts.reshape(stored.shape)


def _count(shape: tuple[int, ...], chunks: tuple[int, ...]) -> int:
    return prod(-(-size // chunk) for size, chunk in zip(shape, chunks, strict=True))


def _pieces(shape: tuple[int, ...], chunks: tuple[int, ...]) -> Iterator[Place]:
    """Divide an array into blocks of at most so many chunks each."""
    steps = list(shape)
    for axis, (size, chunk) in enumerate(zip(shape, chunks, strict=True)):
        others = _count(tuple(steps[axis + 1 :]), chunks[axis + 1 :])
        steps[axis] = min(size, chunk * max(MOST_CHUNKS // max(others, 1), 1))
    ranges = [range(0, size, max(step, 1)) for size, step in zip(shape, steps, strict=True)]
    for starts in product(*ranges):
        yield tuple(
            slice(start, min(start + step, size))
            for start, step, size in zip(starts, steps, shape, strict=True)
        )
