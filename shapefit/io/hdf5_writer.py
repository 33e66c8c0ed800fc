"""Our own HDF5 files, written with checksums for all that they hold.

Metadata have them by their version of HDF5 (`libver` v110), values by `fletcher32`, small datasets
lie in the metadata, and texts have a fixed length, since HDF5 has no checksums for texts of any
length. So damage is an error, and not another number.
"""

from __future__ import annotations

import errno
import os
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from shapefit import core
from shapefit.errors import input_error
from shapefit.io.atomic import atomic_path, storage_errors
from shapefit.io.layout import DICTIONARY, FIELDS, PER_ITEM, VERSION, Column, Layout, stored_name
from shapefit.io.writer import RecordWriter

Array = NDArray[Any]

CHUNK_BYTES, CHUNK_ROWS = 1 << 18, 64

FEWEST_WRITTEN = 1024
"""Items that are written at a time, but for the last: small files come by a hundred."""

MOST_COMPACT = 1 << 14
"""Bytes of a dataset that lies in the metadata."""

SPARE = 1 << 21
"""Bytes that metadata may take beside what is written."""

STEP = 1 << 24
"""Bytes that are reserved beyond at a time, but for small files."""

END_OF_FILE = 28
"""Where the superblock of such a file has its length."""

LIBVER = ("v110", "v110")
"""Version of HDF5 from which on all metadata have checksums; 1.10 and later read it."""


@contextmanager
def hdf5_output(target: Path, form: Layout) -> Iterator[Hdf5Writer]:
    """Give a writer to a file that appears on a clean exit."""
    with atomic_path(target) as path, storage_errors(target, None), _system_errors():
        writer = Hdf5Writer(path, form)
        try:
            yield writer
            writer.finish()
        finally:
            writer.close()


class Hdf5Writer(RecordWriter[Any]):
    """Appends records of one layout to an HDF5 file.

    Datasets per item are chunked and extended along their first axis, what is not per item comes
    from the first record; `attributes` become root attributes at the end, those of the records
    too. Texts per item are held until then, when their greatest length is known.
    """

    def __init__(self, path: Path, form: Layout) -> None:
        super().__init__()
        self._form = form
        self._first: Any = None
        self._whole: dict[str, Array] = {}
        self._shapes: dict[str, tuple[int, ...]] = {}
        self._datasets: dict[str, Any] = {}
        self._waiting: dict[str, list[Array]] = {}
        self._texts: dict[str, list[Array]] = {}
        self._held = 0
        self._space = os.open(path, os.O_RDWR)
        self._reserved = self._end = self._pending = 0
        _allocate(self._space, 0, SPARE)  # of a full disk HDF5 says more than one can read
        self._file = h5py.File(path, "w", libver=LIBVER, rdcc_nbytes=4 * CHUNK_BYTES, locking=False)

    def append(self, record: Any) -> None:
        """Write the items of a record after those that are there.

        Raises ValueError where its landmarks or datasets are not those of the first record.
        """
        columns = getattr(record, "further", {})
        if not self.begun:
            self.begun = True
            self._first = record.take(slice(0)) if self._form is not DICTIONARY else record
            whole = getattr(record, "whole", {})
            self._whole = {name: columns[name] for name in columns if name in whole}
        if record.landmark_names != self._first.landmark_names:
            raise ValueError("the landmarks of this record are not those of the first")
        rows = {
            name: _as_stored(column, value)
            for name, column in self._form.datasets.items()
            for value in [getattr(record, FIELDS.get(name, name), None)]
            if column.per_item and value is not None
        }
        # What was whole in the first record is per item by chance: it has as many rows as these.
        rows |= {name: v for name, v in columns.items() if name not in self._whole}
        shapes = {name: values.shape[1:] for name, values in rows.items()}
        self._shapes = self._shapes or shapes
        if shapes != self._shapes:
            raise ValueError("the datasets of this record are not those of the first")
        for name, values in rows.items():
            if values.dtype.kind in "OU":
                self._texts.setdefault(name, []).append(_encoded(values))
            else:
                self._waiting.setdefault(name, []).append(values)
        self._held += len(rows.get("item", ()))
        self.attributes.update(getattr(record, "attributes", {}))
        if self._held >= FEWEST_WRITTEN:
            self._write_waiting()

    def finish(self) -> None:
        """Write what waits, the texts, and the attributes."""
        self.check_begun()
        self._write_waiting(last=True)
        for name, texts in self._texts.items():
            self._write_texts(name, texts)
        for name, column in self._form.datasets.items():
            value = getattr(self._first, FIELDS.get(name, name), None)
            if value is not None and not column.per_item:
                self._store(name, _as_stored(column, value))
        for name, value in self._whole.items():
            self._store(name, np.asarray(value)).attrs[PER_ITEM] = False
        said: dict[str, Any] = {
            "format": self._form.name,
            "version": VERSION,
            "unit": self._first.unit,
            "y_axis": getattr(self._first, "y_axis", None),
            "frame_rate": getattr(self._first, "frame_rate", None),
        } | {stored_name(name): value for name, value in self.attributes.items()}
        self._reserve(sum(len(str(value)) for value in said.values()) * 4)
        for name, value in said.items():
            if isinstance(value, str):
                text = np.array(value.encode("utf-8", "surrogateescape") or b"\0")
                kind = h5py.string_dtype("utf-8", max(text.itemsize, 1))
                self._file.attrs.create(name, text, dtype=kind)
            elif value is not None:
                self._file.attrs[name] = value

    def close(self) -> None:
        """Close the file, and give back the room that was not needed."""
        try:
            self._file.close()
            size = int.from_bytes(os.pread(self._space, 8, END_OF_FILE), "little")
            if os.fstat(self._space).st_size > size > END_OF_FILE:
                os.ftruncate(self._space, size)
        finally:
            os.close(self._space)

    def _write_waiting(self, *, last: bool = False) -> None:
        """Write the rows that wait; those that fill chunks, before the last."""
        self._held = 0
        rows = {name: np.concatenate(values) for name, values in self._waiting.items()}
        self._reserve(sum(values.nbytes for values in rows.values()))
        for name, values in rows.items():
            if name not in self._datasets:
                self._datasets[name] = self._extendable(name, values)
            dataset = self._datasets[name]
            start, chunk = dataset.shape[0], dataset.chunks[0]
            end = len(values) if last or not values.size else len(values) // chunk * chunk
            dataset.id.set_extent((start + end, *values.shape[1:]))
            whole = end // chunk * chunk if dataset.compression and values.dtype == "f8" else 0
            for at in range(0, whole, chunk):
                place = (start + at,) + (0,) * (values.ndim - 1)
                packed = deflated(values[at : at + chunk])
                dataset.id.write_direct_chunk(place, packed + fletcher32(packed))
            _write_rows(dataset, start + whole, values[whole:end])
            self._waiting[name] = [values[end:]]

    def _write_texts(self, name: str, texts: list[Array]) -> None:
        """Write texts per item, all of the length of the longest."""
        width = max(block.dtype.itemsize for block in texts)
        count, rest = sum(map(len, texts)), texts[0].shape[1:]
        self._reserve(width * count * int(np.prod(rest, dtype=int)))
        kind = h5py.string_dtype("utf-8", width)
        dataset = self._extendable(name, np.empty((count, *rest), f"S{width}"), kind)
        dataset.id.set_extent((count, *rest))
        start = 0
        for block in texts:
            if block.size:
                dataset[start : start + len(block)] = block.astype(kind)
            start += len(block)

    def _extendable(self, name: str, values: Array, kind: Any = None) -> Any:
        """Make an empty dataset for rows like these."""
        rest = values.shape[1:]
        row_bytes = max(values.itemsize * int(np.prod(rest, dtype=int)), 1)
        rows = max(1, min(CHUNK_BYTES // row_bytes, max(len(values), CHUNK_ROWS)))
        sparse = name == "coefficients"
        packed = sparse or (kind is not None and values.itemsize > CHUNK_ROWS)
        return self._file.create_dataset(
            name,
            shape=(0, *rest),
            maxshape=(None, *(size or None for size in rest)),
            chunks=(rows, *(max(size, 1) for size in rest)),
            dtype=kind or values.dtype,
            fletcher32=True,
            **({"compression": "gzip", "compression_opts": 1} if packed else {}),
        )

    def _store(self, name: str, values: Array) -> Any:
        """Store a dataset that does not grow: in the metadata, or in chunks."""
        kind = None
        if values.dtype.kind in "OU":
            values = _encoded(values)
            kind = h5py.string_dtype("utf-8", values.dtype.itemsize)
            values = values.astype(kind)
        self._reserve(values.nbytes)
        if values.nbytes <= MOST_COMPACT:
            return self._store_compact(name, values)
        return self._file.create_dataset(
            name, data=values, dtype=kind, chunks=True, fletcher32=True
        )

    def _store_compact(self, name: str, values: Array) -> Any:
        """Store a small dataset in the metadata; h5py itself cannot do that with a scalar."""
        creation = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
        creation.set_layout(h5py.h5d.COMPACT)
        groups = h5py.h5p.create(h5py.h5p.LINK_CREATE)
        groups.set_create_intermediate_group(True)
        kind = h5py.h5t.py_create(values.dtype, logical=True)
        space = h5py.h5s.create_simple(values.shape) if values.shape else h5py.h5s.create(0)
        place = h5py.h5d.create(self._file.id, name.encode(), kind, space, creation, groups)
        dataset = h5py.Dataset(place)
        if values.size:
            dataset[()] = values
        return dataset

    def _reserve(self, size: int) -> None:
        """Have the disk keep room for so many bytes more, so that HDF5 never meets a full one."""
        self._pending += size
        if self._end + self._pending + SPARE <= self._reserved:
            return
        self._file.flush()
        self._end, self._pending = self._file.id.get_filesize(), size
        needed = self._end + size + SPARE + min(self._end, STEP)
        _allocate(self._space, self._reserved, needed - self._reserved)
        self._reserved = needed


@contextmanager
def _system_errors() -> Iterator[None]:
    """Turn what HDF5 raises where the system refuses to write into the OSError behind it."""
    try:
        yield
    except RuntimeError as error:
        found = re.search(r"errno = (\d+), error message = '([^']*)'", str(error))
        if found is None:
            raise
        raise OSError(int(found[1]), found[2]) from error


def _allocate(file: int, start: int, size: int) -> None:
    """Have the disk keep room, where that is possible; OSError where it is full."""
    try:
        os.posix_fallocate(file, start, size)
    except OSError as error:
        if error.errno not in (errno.EINVAL, errno.EOPNOTSUPP, errno.ENOSYS):
            raise
    except AttributeError:  # a system without it
        return


def _as_stored(dataset: Column, value: Any) -> Array:
    """Return a field of a record as it stands in a file: one point per row."""
    array = np.asarray(value, object) if dataset.kind == "text" else np.asarray(value)
    array = array.astype(dataset.stored) if dataset.stored else array
    return array.swapaxes(-1, -2) if dataset.points else array


def _encoded(texts: Array) -> Array:
    """Return texts in UTF-8, each as long as the longest. Raises InputError for zero bytes."""
    flat = [str(text) for text in np.ravel(texts)]
    if any("\0" in text for text in flat):
        raise input_error("output", "a text has a zero byte, which HDF5 cannot hold", "remove it")
    encoded = np.array([text.encode("utf-8", "surrogateescape") for text in flat] or [b""], "S")
    width = max(encoded.dtype.itemsize, 1)
    return encoded[: len(flat)].astype(f"S{width}").reshape(texts.shape)


def _write_rows(dataset: Any, start: int, values: Array) -> None:
    """Do what `dataset[start:] = values` does in twice the time."""
    if not values.size:
        return
    place = dataset.id.get_space()
    place.select_hyperslab((start,) + (0,) * (values.ndim - 1), values.shape)
    rows = h5py.h5s.create_simple(values.shape)
    values = np.ascontiguousarray(values)
    kind = h5py.h5t.py_create(values.dtype)
    dataset.id.write(rows, place, values, kind)


def deflated(values: Array) -> bytes:
    """Return float64 numbers, most of them 0, as HDF5 knows them by `gzip`."""
    numbers = np.ascontiguousarray(values, "<f8").reshape(-1).view(np.uint64)
    stream = np.empty(len(numbers) * 9 // 8 + 5, np.uint64)
    size = core.deflate(numbers=numbers, stream=stream)
    return stream.view(np.uint8)[:size].tobytes()


def fletcher32(data: bytes) -> bytes:
    """Return the checksum that HDF5 puts behind a chunk.

    Of 16-bit words w_1 .. w_m, the most significant byte first: sum w_i and sum (m + 1 - i) w_i
    modulo 65535, where 0 stands for words that are all 0 alone.
    """
    words = np.frombuffer(data + b"\0" * (len(data) % 2), ">u2").astype(np.uint64)
    parts = words.sum(), (words * np.arange(len(words), 0, -1, dtype=np.uint64)).sum()
    low, high = ((int(part) - 1) % 65535 + 1 if part else 0 for part in parts)
    return (high << 16 | low).to_bytes(4, "little")
