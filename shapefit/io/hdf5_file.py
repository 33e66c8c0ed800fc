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
COPY_FIX = "copy the values into this file (h5repack, or h5py's copy with expand_external)"

TEXT_BYTES, COPIES = 100, 2
"""Bytes of a short text in memory, and copies of numbers while they are read."""

MOST_COMPRESSED = 2000
"""No filter of HDF5 makes data smaller by more: beyond that they were never written."""

MOST_INFLATED = {h5py.h5z.FILTER_DEFLATE: 1033, h5py.h5z.FILTER_LZF: 90}
"""Bytes that a byte of a compressed chunk can become, by the number of the filter."""

SPARE = 1 << 16
"""Bytes beyond its size that a chunk may take: what cannot be made smaller becomes a bit larger."""


def open_hdf5(path: Path, cache_bytes: int | None = None) -> h5py.File:
    """Open a file to read; cache_bytes is the room for chunks of a dataset.

    Raises what h5py raises, and InputError for pipes and for links (`refuse_links`).
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
    links.sort(key=lambda link: link[1] in (h5py.h5l.TYPE_HARD, h5py.h5l.TYPE_SOFT))
    for name, kind in links:  # links out of the file before any is followed
        found, fix = "", COPY_FIX
        if kind == h5py.h5l.TYPE_EXTERNAL:
            found = "is a link to another file"
        elif kind not in (h5py.h5l.TYPE_HARD, h5py.h5l.TYPE_SOFT):
            found = "is a link of a kind that is not known here"
        else:
            try:
                node = h5py.h5o.open(file.id, name)
            except (KeyError, RuntimeError, OSError):  # if damaged, whoever reads it reports that
                if kind == h5py.h5l.TYPE_SOFT:
                    found, fix = "is a soft link to what this file does not hold", "remove it"
            else:
                found = _stored_elsewhere(node)
        if found:
            raise input_error(f"{path}:/{printable(name.decode('utf-8', 'replace'))}", found, fix)


def _stored_elsewhere(node: Any) -> str:
    if not isinstance(node, h5py.h5d.DatasetID):
        return ""
    creation = node.get_create_plist()
    if creation.get_layout() == h5py.h5d.VIRTUAL:
        return "is a virtual dataset, made of others"
    return "has its values in another file" if creation.get_external_count() else ""


class Stored(NamedTuple):
    """A dataset, and what h5py takes long to say of it, and every read wants to know."""

    dataset: Any
    text: bool
    shape: tuple[int, ...]
    chunks: tuple[int, ...] | None
    itemsize: int


class Hdf5File:
    """An open HDF5 file; a context manager. Whatever is wrong is an InputError."""

    def __init__(self, path: Path, cache_bytes: int | None = None) -> None:
        self.path = path
        self._datasets: dict[str, Stored] = {}
        self._suspects: dict[str, list[Any]] = {}
        with self.damage():
            self.root = open_hdf5(path, cache_bytes)

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

    def fault(self, name: str, found: str, fix: str = DAMAGED) -> InputError:
        """Return the error for what is wrong with a dataset or group."""
        return input_error(self.place(name), found, fix)

    @contextmanager
    def damage(self, name: str = "") -> Iterator[None]:
        """Turn what h5py raises for damaged files, and for filters it lacks, into an InputError."""
        try:
            yield
        except (OSError, RuntimeError, LookupError, TypeError, ValueError) as error:
            reason = printable(str(error).partition("\n")[0])
            found, fix = f"cannot be read ({reason})", DAMAGED
            if isinstance(error, UnicodeDecodeError):
                found, fix = "holds text that is not UTF-8", "write its strings as UTF-8"
            elif "plugin" in reason.lower() or "required filter" in reason.lower():
                found = f"is compressed in a way that is not built in here ({reason})"
                fix = "write it again with gzip or without compression"
            raise input_error(self.place(name) if name else self.path, found, fix) from error

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
            return name in self._datasets or isinstance(self.root.get(name), h5py.Dataset)

    def stored(self, name: str) -> Stored:
        """Return a dataset, and what every read wants to know of it."""
        if not self.is_dataset(name):
            raise self.fault(name, "there is no such dataset")
        with self.damage(name):
            if name not in self._datasets:
                dataset = self.root[name]
                text = h5py.check_string_dtype(dataset.dtype) is not None
                sizes = dataset.shape or (), dataset.chunks, dataset.dtype.itemsize
                self._datasets[name] = Stored(dataset, text, *sizes)
            return self._datasets[name]

    def rows(self, name: str, rows: slice | tuple[Any, ...] = ()) -> Any:
        """Return rows of a dataset as they stand in the file, texts as str; `()` is all of it.

        Raises InputError where they are more than memory or the file can hold.
        """
        dataset, text, shape, chunks, itemsize = self.stored(name)
        count = shape[0] if shape else 1
        start, stop, step = (rows if isinstance(rows, slice) else slice(None)).indices(count)
        count = len(range(start, stop, step))
        row_bytes = prod(shape[1:]) * (TEXT_BYTES if text else COPIES * max(itemsize, 8))
        check_fits(
            self.place(name), count * row_bytes + bool(count) * prod(chunks or ()) * itemsize
        )
        size = prod(shape) * itemsize
        with self.damage(name):
            there = dataset.id.get_storage_size() if size > ALWAYS_FITS else size
        if size > MOST_COMPRESSED * there:
            found = f"of its {in_words(size)} the file holds {in_words(there)}"
            raise self.fault(name, found, "write its values, or make it smaller")
        if chunks is not None:
            self._check_chunks(name, start, stop)
        with self.damage(name):
            whole_rows = isinstance(rows, slice) or rows == ()
            if whole_rows and chunks and dataset.dtype.kind in "biuf" and not _is_written(dataset):
                return np.full((count, *shape[1:]), dataset.fillvalue, dataset.dtype)
            values = dataset[rows]
            return _decoded(values) if text else values

    def _check_chunks(self, name: str, start: int, stop: int) -> None:
        """Raise InputError for compressed chunks in these rows that hold more than they declare.

        HDF5 gives filters as much memory as they want: chunks that could want much are tried here.
        """
        dataset, _, _, chunks, itemsize = self.stored(name)
        assert chunks is not None, "the caller sees to that"
        declared = prod(chunks) * itemsize
        with self.damage(name):
            if name not in self._suspects:
                self._suspects[name] = _chunks_to_try(dataset, declared)
            for chunk in list(self._suspects[name]):
                first = chunk.chunk_offset[0]
                if not (first < stop and start < first + chunks[0]):
                    continue
                if not _fits_chunk(dataset, chunk, declared):
                    declares = f"the {in_words(declared)} it declares"
                    raise self.fault(name, f"a compressed chunk holds more than {declares}")
                self._suspects[name].remove(chunk)


def _is_written(dataset: Any) -> bool:
    """Whether any chunk is in the file; HDF5 takes long to go through many that are not."""
    return bool(dataset.id.get_storage_size())


def _filters(dataset: Any) -> list[int]:
    """Return the numbers of the filters of a dataset, in the order of writing."""
    creation = dataset.id.get_create_plist()
    return [creation.get_filter(number)[0] for number in range(creation.get_nfilters())]


def _chunks_to_try(dataset: Any, declared: int) -> list[Any]:
    """Return the chunks that could become larger than declared, and than what always fits."""
    chunks: list[Any] = []
    most = prod(MOST_INFLATED.get(code, 1) for code in _filters(dataset))
    if most > 1:
        dataset.id.chunk_iter(chunks.append)
    return [chunk for chunk in chunks if chunk.size * most > max(declared, ALWAYS_FITS)]


def _fits_chunk(dataset: Any, chunk: Any, declared: int) -> bool:
    """Whether a compressed chunk becomes no larger than declared, or than lzf can make that."""
    most = declared + declared // 100 + SPARE
    if chunk.size > most:
        return False
    mask, data = dataset.id.read_direct_chunk(chunk.chunk_offset)
    used = [code for n, code in enumerate(_filters(dataset)) if not mask >> n & 1]
    for code in reversed([code for code in used if code in MOST_INFLATED]):
        if code != h5py.h5z.FILTER_DEFLATE or len(data) > most:
            break
        try:
            data = zlib.decompressobj().decompress(data, most + 1)
        except zlib.error:  # damaged: whoever reads it reports that
            return True
    return len(data) <= most


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
