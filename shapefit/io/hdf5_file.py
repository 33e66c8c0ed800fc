"""An open HDF5 file, ours or of others: what is wrong is an error that names file and dataset."""

from __future__ import annotations

import os
import zlib
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
FILTERS = ("plugin", "required filter")
"""Words of HDF5 about a compression that it does not have."""


def open_hdf5(path: Path, cache_bytes: int | None = None) -> h5py.File:
    """Open a file to read, an object of a store as a copy on this machine.

    cache_bytes is the room for chunks of a dataset, by default that of HDF5. Raises what h5py
    raises, and InputError where a store does not answer, and for links as `refuse_links`.
    """
    if path.is_fifo():  # opening it would wait for whoever writes
        raise input_error(path, "is a pipe, and HDF5 cannot come through one", "save it to a file")
    file = h5py.File(os.fspath(path), "r", rdcc_nbytes=cache_bytes)
    try:
        refuse_links(file, path)
    except BaseException:
        file.close()
        raise
    return file


COPY_FIX = "copy the values into this file (h5repack, or h5py's copy with expand_external)"


def refuse_links(file: h5py.File, path: Path) -> None:
    """Raise InputError where what a file holds lies elsewhere; nothing outside is touched.

    Elsewhere are external and user-defined links, soft links to what the file does not hold,
    external storage, and virtual datasets, which also can be made of themselves.
    """
    links: list[tuple[bytes, int]] = []
    try:
        file.id.links.visit(lambda name, info: links.append((name, info.type)), info=True)
    except RuntimeError as error:  # damaged where the links are: as if it could not be opened
        raise OSError(str(error)) from error

    def refuse(name: bytes, found: str, fix: str = COPY_FIX) -> None:
        raise input_error(f"{path}:/{printable(name.decode('utf-8', 'replace'))}", found, fix)

    for name, kind in links:
        if kind == h5py.h5l.TYPE_EXTERNAL:
            refuse(name, "is a link to another file")
        if kind not in (h5py.h5l.TYPE_HARD, h5py.h5l.TYPE_SOFT):
            refuse(name, "is a link of a kind that is not known here")
    for name, kind in links:
        try:
            node = h5py.h5o.open(file.id, name)
        except (KeyError, RuntimeError, OSError):
            if kind == h5py.h5l.TYPE_SOFT:
                refuse(name, "is a soft link to what this file does not hold", "remove it")
            continue  # damaged: whoever reads it reports that
        if not isinstance(node, h5py.h5d.DatasetID):
            continue
        creation = node.get_create_plist()
        if creation.get_layout() == h5py.h5d.VIRTUAL:
            refuse(name, "is a virtual dataset, made of others")
        if creation.get_external_count():
            refuse(name, "has its values in another file")


class Hdf5File:
    """An open HDF5 file; a context manager. Whatever is wrong is an InputError."""

    def __init__(self, path: Path, cache_bytes: int | None = None) -> None:
        self.path = path
        self._asked: dict[str, Stored] = {}
        self._suspects: dict[str, list[Any]] = {}
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
                found = self.root[name]
                text = h5py.check_string_dtype(found.dtype) is not None
                sizes = found.shape or (), found.chunks, found.dtype.itemsize
                self._asked[name] = Stored(found, text, *sizes)
            return self._asked[name]

    def row_bytes(self, name: str) -> int:
        """Bytes that a row of a dataset takes while it is read."""
        stored = self.stored(name)
        return prod(stored.shape[1:]) * (TEXT if stored.text else COPIES * max(stored.itemsize, 8))

    def rows(self, name: str, rows: slice | tuple[Any, ...] = ()) -> Any:
        """Return rows of a dataset as they stand in the file, texts as str; `()` is all of it.

        Raises InputError where they are more than memory or the file can hold.
        """
        stored = self.stored(name)
        count = stored.shape[0] if stored.shape else 1
        count = len(range(*rows.indices(count))) if isinstance(rows, slice) else count
        chunk = prod(stored.chunks or ()) * stored.itemsize if count else 0
        check_fits(self.place(name), count * self.row_bytes(name) + chunk)
        with self.damage(name):
            size = prod(stored.shape) * stored.itemsize
            there = stored.dataset.id.get_storage_size() if size > ALWAYS_FITS else size
        if size > MOST_COMPRESSED * there:
            found = f"of its {in_words(size)} the file holds {in_words(there)}"
            raise self.fault(name, found, "write its values, or make it smaller")
        self._check_chunks(name, stored, rows)
        with self.damage(name):
            values = stored.dataset[rows]
            return _decoded(values) if stored.text else values

    def _check_chunks(self, name: str, stored: Stored, rows: slice | tuple[Any, ...]) -> None:
        """Raise InputError for compressed chunks in these rows that hold more than they declare.

        HDF5 gives gzip and lzf as much memory as they want. Only chunks that could want much are
        tried: here, in pieces that are dropped.
        """
        if stored.chunks is None:
            return
        declared = prod(stored.chunks) * stored.itemsize
        with self.damage(name):
            filters = _filters(stored.dataset)
            if not any(code in (h5py.h5z.FILTER_DEFLATE, h5py.h5z.FILTER_LZF) for code in filters):
                return
            if name not in self._suspects:
                self._suspects[name] = _large_chunks(stored.dataset, declared)
        whole = slice(None) if rows == () or not isinstance(rows, slice) else rows
        start, stop, _ = whole.indices(stored.shape[0])
        for chunk in list(self._suspects[name]):
            first = chunk.chunk_offset[0]
            if first >= stop or first + stored.chunks[0] <= start:
                continue
            with self.damage(name):
                fits = _fits_chunk(stored.dataset, chunk, declared, filters)
            if not fits:
                found = f"a compressed chunk holds more than the {in_words(declared)} it declares"
                raise self.fault(name, found)
            self._suspects[name].remove(chunk)


TEXT = 100
"""Bytes of a short text in memory, and of the place where it is held."""

COPIES = 2
"""Of what is read: as it stands in the file, and as the records have it."""

MOST_COMPRESSED = 2000
"""No filter of HDF5 makes data smaller by more: beyond that they were never written."""


MOST_INFLATED = {h5py.h5z.FILTER_DEFLATE: 1033, h5py.h5z.FILTER_LZF: 90}
"""Bytes that a byte of a compressed chunk can become, by the number of the filter."""

PIECE = 1 << 16
"""Bytes of a compressed chunk that are inflated at a time."""


def _filters(dataset: Any) -> list[int]:
    creation = dataset.id.get_create_plist()
    return [creation.get_filter(number)[0] for number in range(creation.get_nfilters())]


def _large_chunks(dataset: Any, declared: int) -> list[Any]:
    """Return the chunks that could become larger than what everyone has room for."""
    found: list[Any] = []
    most = max(MOST_INFLATED.get(code, 1) for code in _filters(dataset))
    several = sum(code in MOST_INFLATED for code in _filters(dataset)) > 1
    room = max(declared, ALWAYS_FITS)

    def look(chunk: Any) -> None:
        if several or chunk.size * most > room:
            found.append(chunk)

    dataset.id.chunk_iter(look)
    return found


def _fits_chunk(dataset: Any, chunk: Any, declared: int, filters: list[int]) -> bool:
    """Whether a compressed chunk becomes no larger than a chunk of its dataset is."""
    used = [code for n, code in enumerate(filters) if not chunk.filter_mask >> n & 1]
    used = [code for code in used if code in MOST_INFLATED]
    most = declared + declared // 100 + PIECE  # what cannot be made smaller becomes a bit larger
    if len(used) > 1 or chunk.size > most:
        return False
    if used != [h5py.h5z.FILTER_DEFLATE]:
        return True
    _, raw = dataset.id.read_direct_chunk(chunk.chunk_offset)
    inflater, size = zlib.decompressobj(), 0
    for start in range(0, len(raw), PIECE):
        piece = raw[start : start + PIECE]
        while piece and size <= most:
            try:
                size += len(inflater.decompress(piece, PIECE))
            except zlib.error:  # damaged: whoever reads it reports that
                return True
            piece = inflater.unconsumed_tail
    return size <= most


class Stored(NamedTuple):
    """A dataset, and what h5py takes long to say of it, and every read wants to know."""

    dataset: Any
    text: bool
    shape: tuple[int, ...]
    chunks: tuple[int, ...] | None
    itemsize: int


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
