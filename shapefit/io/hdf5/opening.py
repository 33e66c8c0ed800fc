"""An HDF5 file opened for reading, here or in an object store, and its datasets piece by piece."""

from __future__ import annotations

import gc
import threading
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product
from math import prod
from pathlib import Path
from typing import Any, Self

import h5py
import numpy as np
from numpy.typing import NDArray

from shapefit.errors import input_error
from shapefit.io.hdf5.trial import try_opening
from shapefit.stores.opening import store_errors
from shapefit.stores.reading import shared_bytes
from shapefit.stores.shelf import has_copy
from shapefit.stores.urls import UrlPath

MOST_GARBAGE = 50_000
"""Objects made since the last collection beyond which the next fetch of a block collects."""


def open_hdf5(path: Path, cache_bytes: int | None = None) -> h5py.File:
    """Open a file to read; of an object only the blocks that are read are fetched.

    cache_bytes is the room for chunks of a dataset, by default that of HDF5. Raises what h5py
    raises, and InputError where a store does not answer, and where libhdf5 would hang or crash.
    """
    if isinstance(path, UrlPath) and not has_copy(path):
        return _RemoteFile(path, cache_bytes)
    try_opening(path)
    return h5py.File(path, "r", rdcc_nbytes=cache_bytes)


class _RemoteFile(h5py.File):  # type: ignore[misc]
    """An HDF5 file in a store, while which is open no thread collects garbage by itself.

    h5py waits for a block with its lock in hand, and the thread that fetches the block would wait
    for this lock for ever, if it came to collect an object of h5py.
    """

    def __init__(self, path: UrlPath, cache_bytes: int | None) -> None:
        _pause()
        self._paused = True
        try:
            super().__init__(_Blocks(path), "r", rdcc_nbytes=cache_bytes)
        except BaseException:
            self._resume()
            raise

    def close(self) -> None:
        """Close the file."""
        super().close()
        self._resume()

    def _resume(self) -> None:
        if self._paused:
            self._paused = False
            _resume()


class _Blocks:
    """What h5py reads an object by; errors of the store pass through it."""

    def __init__(self, path: UrlPath) -> None:
        self._path = path
        self._file = shared_bytes(path)

    def seek(self, offset: int, whence: int = 0) -> int:
        """Go to a place in the object; returns it."""
        return self._file.seek(offset, whence)

    def tell(self) -> int:
        """Return the place in the object."""
        return self._file.tell()

    def read(self, size: int = -1) -> bytes:
        """Return bytes from here; h5py knows a file by this."""
        with store_errors(self._path):
            return self._file.read(size)

    def readinto(self, buffer: Any) -> int:
        """Fill a buffer from here."""
        if gc.get_count()[0] > MOST_GARBAGE:
            gc.collect()
        data = self.read(len(buffer))
        buffer[: len(data)] = data
        return len(data)


_open = 0
_was_enabled = False
_counting = threading.Lock()


def _pause() -> None:
    """Stop the collection of garbage, that of the thread that fetches included."""
    global _open, _was_enabled
    with _counting:
        if _open == 0:
            _was_enabled = gc.isenabled()
            gc.disable()
        _open += 1
    from asyncio import sleep

    from fsspec.asyn import get_loop, sync

    sync(get_loop(), sleep, 0)  # what it was at is done


def _resume() -> None:
    global _open
    with _counting:
        _open -= 1
        if _open == 0 and _was_enabled:
            gc.enable()


TEXT = 100
"""Bytes of a short text in memory, and of the place where it is held."""

COPIES = 2
"""Of what is read: as it stands in the file, and as the records have it."""


MOST_COMPRESSED = 2000
"""No filter of HDF5 makes data smaller by more: beyond that they were never written."""


def was_written(dataset: Any) -> bool:
    """Whether the values of a dataset can have been written, by the place that they take."""
    return bool(dataset.nbytes <= MOST_COMPRESSED * dataset.id.get_storage_size())


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
