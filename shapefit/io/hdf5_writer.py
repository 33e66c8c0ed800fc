"""Our own HDF5 files, written so that damage is an error, and not another number.

Metadata have checksums by their version of HDF5 (`libver` v110), values by `fletcher32`, and small
datasets lie in the metadata. Texts have a fixed length, since HDF5 has no checksums for texts of
any length; those of the root attributes, which are plain texts, have one in an attribute.
"""

from __future__ import annotations

import errno
import os
import re
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from shapefit.errors import input_error
from shapefit.io.atomic import atomic_path, storage_errors
from shapefit.io.hdf5_records import digest_of
from shapefit.io.layout import DIGEST, FIELDS, PER_ITEM, VERSION, Column, Layout, stored_name
from shapefit.io.writer import RecordWriter

Array = NDArray[Any]

CHUNK_BYTES, MIN_CHUNK_ROWS = 1 << 18, 64

COMPACT_BYTES = 1 << 14
"""At most of a dataset that lies in the metadata."""

SPARE, STEP, SHARE_OF_METADATA = 1 << 21, 1 << 24, 50
"""Bytes reserved beside what is written, at most ahead of it, and its share for metadata."""

END_OF_FILE = 28
"""Where the superblock of such a file has its length."""

LIBVER = ("v110", "v110")
"""Version of HDF5 from which on all metadata have checksums; 1.10 and later read it."""


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
    too. Texts per item are held until then, when their greatest length is known.
    """

    def __init__(self, file: Any, form: Layout, reserve: Callable[[int], None]) -> None:
        super().__init__()
        self._file, self._form, self._reserve = file, form, reserve
        self._first: Any = None
        self._whole: dict[str, Array] = {}
        self._shapes: dict[str, tuple[int, ...]] = {}
        self._texts: dict[str, list[Array]] = {}

    def append(self, record: Any) -> None:
        """Write the items of a record after those that are there.

        Raises ValueError where its landmarks or datasets are not those of the first record.
        """
        rows, whole = _as_stored(record, self._form)
        shapes = {name: values.shape[1:] for name, values in rows.items()}
        if not self.begun:
            self.begun = True
            self._first, self._whole, self._shapes = record, whole, shapes
        if record.landmark_names != self._first.landmark_names:
            raise ValueError("the landmarks of this record are not those of the first")
        if shapes != self._shapes:
            raise ValueError("the datasets of this record are not those of the first")
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
            kind = h5py.string_dtype("utf-8", max(block.dtype.itemsize for block in blocks))
            for block in blocks:
                self._write_rows(name, block.astype(kind), kind)
        for name, values in self._whole.items():
            self._write_whole(name, values)
        for name in self._shapes.keys() - self._form.names:
            self._file[name].attrs[PER_ITEM] = True
        stated: dict[str, Any] = {
            "format": self._form.name,
            "version": VERSION,
            "unit": self._first.unit,
            "y_axis": getattr(self._first, "y_axis", None),
            "frame_rate": getattr(self._first, "frame_rate", None),
        } | {stored_name(name): value for name, value in self.attributes.items()}
        stated = {name: value for name, value in stated.items() if value is not None}
        self._reserve(sum(len(str(value)) for value in stated.values()) * 4)
        for name, value in (stated | {DIGEST: digest_of(stated)}).items():
            self._file.attrs[name] = value

    def _write_rows(self, name: str, values: Array, kind: Any = None) -> None:
        """Write rows of a dataset behind those that are there."""
        if name not in self._file:
            self._make_extendable(name, values, kind)
        self._reserve(values.nbytes)
        dataset = self._file[name].id
        start, *_ = dataset.shape
        dataset.set_extent((start + len(values), *values.shape[1:]))
        if values.size:  # in half the time of `dataset[start:] = values`
            place = dataset.get_space()
            place.select_hyperslab((start,) + (0,) * (values.ndim - 1), values.shape)
            space = h5py.h5s.create_simple(values.shape)
            values = np.ascontiguousarray(values)
            dataset.write(space, place, values, h5py.h5t.py_create(values.dtype, logical=True))

    def _make_extendable(self, name: str, values: Array, kind: Any) -> None:
        """Make an empty dataset for rows like these, in chunks of a power of two of them."""
        rest = values.shape[1:]
        row_bytes = max(values.itemsize * int(np.prod(rest, dtype=int)), 1)
        rows = max(1, min(CHUNK_BYTES // row_bytes, max(len(values), MIN_CHUNK_ROWS)))
        rows = 1 << (rows.bit_length() - 1)
        self._reserve(rows * row_bytes)
        self._file.create_dataset(
            name,
            shape=(0, *rest),
            maxshape=(None, *(size or None for size in rest)),
            chunks=(rows, *(max(size, 1) for size in rest)),
            dtype=kind or values.dtype,
            fletcher32=True,
        )

    def _write_whole(self, name: str, values: Array) -> None:
        """Write a dataset of the file: in the metadata, or in chunks."""
        kind = None
        if values.dtype.kind in "OU":
            encoded = _encoded(values)
            kind = h5py.string_dtype("utf-8", encoded.dtype.itemsize)
            values = encoded.astype(kind)
        self._reserve(2 * values.nbytes)
        if values.nbytes > COMPACT_BYTES:
            self._file.create_dataset(name, data=values, dtype=kind, chunks=True, fletcher32=True)
            return
        creation, links = (
            h5py.h5p.create(h5py.h5p.DATASET_CREATE),
            h5py.h5p.create(h5py.h5p.LINK_CREATE),
        )
        creation.set_layout(h5py.h5d.COMPACT)
        links.set_create_intermediate_group(True)
        space = h5py.h5s.create_simple(values.shape) if values.shape else h5py.h5s.create(0)
        kind = h5py.h5t.py_create(values.dtype, logical=True)
        place = h5py.h5d.create(self._file.id, name.encode(), kind, space, creation, links)
        if values.size:
            h5py.Dataset(place)[()] = values


def _as_stored(record: Any, form: Layout) -> tuple[dict[str, Array], dict[str, Array]]:
    """Return what a record, or a dictionary, holds as it stands in a file: per item, and whole."""
    known = {name: getattr(record, FIELDS.get(name, name), None) for name in form.datasets}
    stored = {
        name: _turned(form.datasets[name], value)
        for name, value in known.items()
        if value is not None
    }
    per_item: Mapping[str, Any] = getattr(record, "per_item", {})
    whole: Mapping[str, Any] = getattr(record, "whole", {})
    rows = {name: values for name, values in stored.items() if form.datasets[name].per_item}
    rest = {name: values for name, values in stored.items() if name not in rows}
    rows |= {name: np.asarray(v) for name, v in per_item.items() if name not in form.names}
    return rows, rest | {n: np.asarray(v) for n, v in whole.items() if n not in form.names}


def _turned(column: Column, value: Any) -> Array:
    """Return a column as it stands in a file: one point per row."""
    array = np.asarray(value, object) if column.kind == "text" else np.asarray(value)
    array = array.astype(column.stored) if column.stored else array
    return array.swapaxes(-1, -2) if column.points else array


def _encoded(texts: Array) -> Array:
    """Return texts in UTF-8, each as long as the longest. Raises InputError for zero bytes."""
    flat = [str(text) for text in np.ravel(texts)]
    if any("\0" in text for text in flat):
        raise input_error("output", "a text has a zero byte, which HDF5 cannot hold", "remove it")
    encoded = np.array([text.encode("utf-8", "surrogateescape") for text in flat] or [b""], "S")
    width = max(encoded.dtype.itemsize, 1)
    return encoded[: len(flat)].astype(f"S{width}").reshape(texts.shape)


@contextmanager
def _disk_space(path: Path) -> Iterator[Callable[[int], None]]:
    """Give what reserves room on the disk for bytes that follow: a full one crashes HDF5.

    What was not needed is given back after the file was closed.
    """
    file = os.open(path, os.O_RDWR)
    needed, reserved = SPARE, 0

    def reserve(size: int) -> None:
        nonlocal needed, reserved
        needed += size + size // SHARE_OF_METADATA
        if needed > reserved:
            more = needed + min(needed, STEP) - reserved
            _allocate(file, reserved, more)
            reserved += more

    try:
        reserve(0)
        yield reserve
        size = int.from_bytes(os.pread(file, 8, END_OF_FILE), "little")
        if os.fstat(file).st_size > size > END_OF_FILE:
            os.ftruncate(file, size)
    finally:
        os.close(file)


def _allocate(file: int, start: int, size: int) -> None:
    """Reserve room in a file, where the system can; OSError where the disk is full."""
    try:
        os.posix_fallocate(file, start, size)
    except OSError as error:
        if error.errno not in (errno.EINVAL, errno.EOPNOTSUPP, errno.ENOSYS):
            raise
    except AttributeError:  # a system without it
        return


@contextmanager
def _system_errors() -> Iterator[None]:
    """Turn what HDF5 raises where the system refuses to write into the OSError behind it."""
    try:
        yield
    except (OSError, RuntimeError) as error:
        found = re.search(r"errno = (\d+)", str(error))
        if found is None:
            raise
        raise OSError(int(found[1]), os.strerror(int(found[1]))) from error
