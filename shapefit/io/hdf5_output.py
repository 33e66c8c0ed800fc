"""Our own HDF5 files, written: records and dictionaries of the known layouts.

Metadata have checksums by their version of HDF5 (`libver` v110), values by
`fletcher32`; texts have a fixed length, since HDF5 has no checksums for texts of any
length.
"""

from __future__ import annotations

import errno
import math
import os
import re
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache, lru_cache
from pathlib import Path, PurePosixPath
from typing import IO

import h5py
import numpy as np

from shapefit.dictionary.model import Dictionary
from shapefit.errors import input_error, printable
from shapefit.io.atomic import atomic_path, storage_errors
from shapefit.io.contents import (
    DigestLine,
    ValuesDigest,
    describe_attribute,
    describe_values,
    digest_of_lines,
    kind_of_dtype,
)
from shapefit.io.hdf5_file import PLAIN_ATTRIBUTES, PREFIX
from shapefit.io.layout import (
    CONTENTS,
    DICTIONARY,
    DICTIONARY_POINTS,
    PER_ITEM,
    VERSION,
    Layout,
)
from shapefit.io.options import RecordWriter, Summary
from shapefit.records.columns import Array, present_columns
from shapefit.records.items import Items

CHUNK_BYTES = 1 << 18
"""Of the rows of a dataset that HDF5 stores as one piece."""

SPARE = 1 << 21
"""Bytes that are reserved on the disk beside what is written."""

METADATA_SHARE = 50
"""Of one byte of metadata for so many of values, when space is reserved."""

TEXT = h5py.string_dtype()
"""Of an attribute: a text of any length."""

NAMES = ("item", "sequence", "landmark_names")
"""Datasets by whose texts images and landmarks are told apart."""


@contextmanager
def hdf5_output(target: Path, layout: Layout) -> Iterator[Hdf5Writer]:
    """Give an Hdf5Writer to `target`, which appears on a clean exit."""
    options = {
        "libver": ("v110", "v110"),
        "rdcc_nbytes": 4 * CHUNK_BYTES,
        "locking": False,
    }
    with (
        atomic_path(target) as path,
        storage_errors(target, None),
        path.open("r+b") as space,
    ):
        _reserve(space, SPARE)  # before HDF5 has anything to write
        try:
            with h5py.File(path, "w", **options) as file:
                writer = Hdf5Writer(file, layout, space)
                yield writer
                writer.finish()
                size = file.id.get_filesize()
        except (OSError, RuntimeError) as error:
            number = re.search(r"errno = (\d+)", str(error))
            if number is None:
                raise
            raise OSError(int(number[1]), os.strerror(int(number[1]))) from error
        space.truncate(min(size, path.stat().st_size))  # closing can make it shorter


def _reserve(file: IO[bytes], size: int) -> None:
    """Reserve `size` bytes on the disk for an open file, where the system can."""
    try:
        os.posix_fallocate(file.fileno(), 0, size)
    except (AttributeError, OSError) as error:  # macOS has no such function
        if getattr(error, "errno", None) not in (None, errno.EINVAL, errno.EOPNOTSUPP):
            raise


class Hdf5Writer(RecordWriter[Items | Dictionary]):
    """Appends records of one layout to an HDF5 file.

    What is not per item comes from the first record. `attributes`, those of records
    too, become root attributes at the end. Rows are buffered until they fill a chunk,
    since a call of HDF5 takes as long as many rows; texts per item to the end, when
    their length is known.
    """

    def __init__(self, file: h5py.File, layout: Layout, space: IO[bytes]) -> None:
        """Take an open HDF5 file; `space` is the same file, to reserve disk space."""
        super().__init__()
        self._file, self._layout, self._space = file, layout, space
        self._needed = self._reserved = 0
        self._first: Items | Dictionary | None = None
        self._whole: dict[str, Array] = {}
        self._shapes: dict[str, tuple[int, ...]] = {}
        self._buffered: dict[str, list[Array]] = {}
        self._buffered_bytes: dict[str, int] = {}
        self._texts: dict[str, list[Array]] = {}
        self._datasets: dict[str, _StoredDataset] = {}
        self._digests: dict[str, ValuesDigest] = {}

    def append(self, record: Items | Dictionary) -> None:
        """Write the items of a record after those already written.

        Raises ValueError where its landmarks or datasets are not those of the first
        record.
        """
        rows, whole = _datasets_of(record)
        shapes = {name: values.shape[1:] for name, values in rows.items()}
        if self._first is None:
            self.begun = True
            self._first = record
            self._whole = whole
            self._shapes = shapes
        same_names = record.landmark_names == self._first.landmark_names
        if not same_names or shapes != self._shapes:
            raise ValueError(
                "the landmarks or datasets of this record are not those of the first"
            )
        for name, values in rows.items():
            if values.dtype.kind in "OU":
                self._texts.setdefault(name, []).append(_encode_texts(name, values))
            else:
                self._buffer_rows(name, values)
        if isinstance(record, Items):
            self.attributes.update(record.attributes)

    def finish(self) -> None:
        """Write buffered rows, datasets that are not per item, and attributes."""
        self.check_begun()
        for name in [*self._buffered]:
            self._flush_rows(name, are_last=True)
        for name, blocks in self._texts.items():
            width = max(block.dtype.itemsize for block in blocks)
            kind = h5py.string_dtype("utf-8", width)
            rows = _join_rows([block.astype(kind) for block in blocks])
            self._write_rows(name, rows, are_last=True)
        for name, values in self._whole.items():
            self._write_whole(name, values)
        for name in self._per_item_datasets:
            _set_attribute(self._datasets[name].handle, PER_ITEM, True)
        self._write_attributes()
        if self.seal is not None:
            digest = digest_of_lines(self._digest_lines())
            _set_attribute(self._file.id, CONTENTS, digest)
            self.summary = Summary(digest=digest)
        self._file.flush()
        self._datasets.clear()

    @property
    def _per_item_datasets(self) -> Collection[str]:
        """Names of the datasets that get the attribute PER_ITEM."""
        return self._shapes.keys() - self._layout.unmarked

    def _buffer_rows(self, name: str, values: Array) -> None:
        """Buffer rows of a dataset; write all buffered rows when they fill a chunk."""
        self._buffered.setdefault(name, []).append(values)
        size = self._buffered_bytes.get(name, 0) + values.nbytes
        self._buffered_bytes[name] = size
        if size >= CHUNK_BYTES:
            self._flush_rows(name)

    def _flush_rows(self, name: str, *, are_last: bool = False) -> None:
        """Write the buffered rows of a dataset."""
        del self._buffered_bytes[name]
        self._write_rows(name, _join_rows(self._buffered.pop(name)), are_last=are_last)

    def _write_rows(self, name: str, values: Array, *, are_last: bool = False) -> None:
        """Append rows to a dataset, which is created with its first rows.

        A dataset whose first rows are its last ones cannot grow: HDF5 then needs no
        index of its chunks.
        """
        self._reserve_for(values.nbytes)
        self._update_digest(name, values)
        if name not in self._datasets:
            rest = values.shape[1:]
            rows = _chunk_rows(values)
            self._reserve_for(rows * values.itemsize * math.prod(rest))
            self._datasets[name] = _create_dataset(
                self._file.id,
                name,
                values,
                chunks=(rows, *(max(size, 1) for size in rest)),
                grows=not are_last,
            )
            return
        self._datasets[name].extend(values)

    def _write_whole(self, name: str, values: Array) -> None:
        """Write a dataset that is not per item."""
        stored = _encode_texts(name, values) if values.dtype.kind in "OU" else values
        self._reserve_for(2 * stored.nbytes)
        self._update_digest(name, stored)
        # HDF5 has no checksum for one value.
        checked = stored.size > 0 and stored.ndim > 0
        self._datasets[name] = _create_dataset(
            self._file.id, name, stored, chunks=stored.shape if checked else None
        )

    def _write_attributes(self) -> None:
        """Write the root attributes of the file."""
        stated = self._root_attributes()
        self._reserve_for(sum(len(str(value)) for value in stated.values()) * 4)
        for name, value in stated.items():
            _set_attribute(self._file.id, name, value)

    def _root_attributes(self) -> Mapping[str, object]:
        """Return the root attributes: format, unit and so on, and `attributes`.

        One of `attributes` gets a prefix where the layout has one of its name.
        """
        stated: dict[str, object] = {"format": self._layout.name, "version": VERSION}
        for name in ("unit", "y_axis", "frame_rate"):
            stated[name] = getattr(self._first, name, None)
        for name, value in self.attributes.items():
            prefix = PREFIX if name in PLAIN_ATTRIBUTES else ""
            stated[prefix + name] = value
        stated |= self.seal or {}
        return {name: value for name, value in stated.items() if value is not None}

    def _update_digest(self, name: str, values: Array) -> None:
        """Add written values to the digest of their dataset, if the file gets one."""
        if self.seal is not None:
            self._digests.setdefault(name, ValuesDigest()).add(values)

    def _digest_lines(self) -> Iterator[DigestLine]:
        """Describe each attribute, dataset and group in the file as a list to hash.

        `digest_contents` reads the same from the file, which takes longer.
        """
        for name, value in self._root_attributes().items():
            yield describe_attribute("/", name, value)
        for name, dataset in self._datasets.items():
            kind = kind_of_dtype(dataset.dtype)
            yield describe_values(name, kind, dataset.shape, self._digests[name])
        for name in self._per_item_datasets:
            yield describe_attribute(name, PER_ITEM, True)
        in_groups = [PurePosixPath(name) for name in self._datasets if "/" in name]
        groups = {str(group) for path in in_groups for group in path.parents}
        for group in groups - {"."}:
            yield ["Group", group]

    def _reserve_for(self, size: int) -> None:
        """Reserve disk space for `size` more bytes, as HDF5 crashes on a full disk."""
        self._needed += size + size // METADATA_SHARE
        if self._needed > self._reserved:
            self._reserved = self._needed + SPARE + min(self._needed, 7 * SPARE)
            _reserve(self._space, self._reserved)


@dataclass(eq=False, repr=False)
class _StoredDataset:
    """A dataset in the file, by the handle of HDF5, and what was written to it."""

    handle: h5py.h5d.DatasetID
    dtype: np.dtype[np.generic]
    shape: tuple[int, ...]

    def extend(self, values: Array) -> None:
        """Append rows."""
        start = self.shape[0]
        self.shape = (start + len(values), *self.shape[1:])
        self.handle.set_extent(self.shape)
        h5py.Dataset(self.handle)[start:] = values


# By the calls of HDF5 itself, with what can be made once: `create_dataset` takes three
# times as long, and what is written of an image are 23 datasets of a few bytes.


def _create_dataset(
    file: h5py.h5f.FileID,
    name: str,
    values: Array,
    chunks: tuple[int, ...] | None,
    *,
    grows: bool = False,
) -> _StoredDataset:
    """Create a dataset of these values, with checksums where it has chunks."""
    limits = values.shape
    if grows:
        rest = (size or h5py.h5s.UNLIMITED for size in values.shape[1:])
        limits = (h5py.h5s.UNLIMITED, *rest)
    kind = _hdf5_type(values.dtype)
    made = h5py.h5d.create(
        file,
        name.encode(),
        kind,
        _dataspace(values.shape, limits),
        _creation_properties(chunks),
        _link_properties(),
    )
    if values.size:
        made.write(h5py.h5s.ALL, h5py.h5s.ALL, np.ascontiguousarray(values), kind)
    return _StoredDataset(made, values.dtype, values.shape)


@lru_cache(maxsize=64)
def _creation_properties(chunks: tuple[int, ...] | None) -> h5py.h5p.PropDCID:
    """Return HDF5's properties of a dataset: chunks with checksums, or contiguous."""
    storage = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    storage.set_obj_track_times(False)
    if chunks is not None:
        storage.set_chunk(chunks)
        storage.set_fletcher32()
    return storage


@cache
def _link_properties() -> h5py.h5p.PropLCID:
    """Return HDF5's properties of a link: UTF-8 names, missing groups are created."""
    path = h5py.h5p.create(h5py.h5p.LINK_CREATE)
    path.set_create_intermediate_group(True)
    path.set_char_encoding(h5py.h5t.CSET_UTF8)
    return path


def _set_attribute(node: h5py.h5g.GroupID, name: str, value: object) -> None:
    """Create an attribute of a file or dataset."""
    if not isinstance(value, str | bool | int | float):
        h5py.AttributeManager(h5py.HLObject(node))[name] = value
        return
    stored = np.asarray(value, TEXT if isinstance(value, str) else None)
    kind = _hdf5_type(stored.dtype)
    h5py.h5a.create(node, name.encode(), kind, _dataspace((), ())).write(stored)


def _hdf5_type(dtype: np.dtype[np.generic]) -> h5py.h5t.TypeID:
    """Return the HDF5 type of values; those of numbers and of attributes' texts are
    made once.
    """
    if dtype is TEXT:
        return _text_type()
    if dtype.kind in "biuf" and dtype.metadata is None:
        return _number_type(dtype)
    return h5py.h5t.py_create(dtype, logical=True)


@cache
def _text_type() -> h5py.h5t.TypeID:
    """Return the HDF5 type of a text of any length."""
    return h5py.h5t.py_create(TEXT, logical=True)


@cache
def _number_type(dtype: np.dtype[np.generic]) -> h5py.h5t.TypeID:
    """Return the HDF5 type of numbers or flags."""
    return h5py.h5t.py_create(dtype, logical=True)


@lru_cache(maxsize=64)
def _dataspace(shape: tuple[int, ...], limits: tuple[int, ...]) -> h5py.h5s.SpaceID:
    """Return the HDF5 dataspace of a shape that can grow up to `limits`."""
    if not shape:
        return h5py.h5s.create(h5py.h5s.SCALAR)
    return h5py.h5s.create_simple(shape, limits)


def _join_rows(blocks: list[Array]) -> Array:
    """Concatenate blocks of rows; a single block is not copied."""
    return blocks[0] if len(blocks) == 1 else np.concatenate(blocks)


def _chunk_rows(values: Array) -> int:
    """Return how many rows a chunk has in a dataset whose first rows are `values`.

    All of them where they are less than CHUNK_BYTES, else a power of two.
    """
    row_bytes = max(values.itemsize * math.prod(values.shape[1:]), 1)
    most = max(CHUNK_BYTES // row_bytes, 1)
    if len(values) <= most:
        return max(len(values), 1)
    return 1 << (most.bit_length() - 1)


def _datasets_of(
    record: Items | Dictionary,
) -> tuple[dict[str, Array], dict[str, Array]]:
    """Return a record's or dictionary's datasets by name: per item, and the others."""
    if not isinstance(record, Items):
        return {}, _datasets_of_dictionary(record)
    rows = dict(record.extras)
    whole = dict(record.file_extras)
    for column, value in present_columns(record):
        stored = np.asarray(value, object) if column.is_text else np.asarray(value)
        if column.per_item:
            rows[column.name] = stored
        else:
            whole[column.name] = stored
    return rows, whole


def _datasets_of_dictionary(dictionary: Dictionary) -> dict[str, Array]:
    """Return a dictionary's datasets by name, their points one a row: (..., p, 3)."""
    whole: dict[str, Array] = {}
    for name, column in DICTIONARY.columns.items():
        value = getattr(dictionary, column.field, None)
        if value is None:
            continue
        stored = np.asarray(value, object) if column.is_text else np.asarray(value)
        whole[name] = stored.swapaxes(-1, -2) if name in DICTIONARY_POINTS else stored
    return whole


def _encode_texts(name: str, texts: Array) -> Array:
    """Encode texts of the dataset `name` as UTF-8 of one width, that of the longest.

    Raises InputError for a name with the character NUL, where HDF5 would cut it off.
    """
    given = np.ravel(texts).tolist()
    unique = [*dict.fromkeys(given)]
    utf_8 = [str(text).encode("utf-8", "backslashreplace") for text in unique]
    with_nul = next((text for text in utf_8 if b"\0" in text), None)
    if with_nul is not None and name in NAMES:
        shown = printable(with_nul.decode("utf-8", "replace"))
        fault = f"the name '{shown}' has a character NUL, which HDF5 cannot hold"
        raise input_error(f"/{name}", fault, "rename it")
    kind = h5py.string_dtype("utf-8", max(map(len, utf_8), default=0) or 1)
    encoded = np.array(utf_8, kind)
    if len(unique) < len(given):  # as names of sequences, and reasons
        number_of = {text: number for number, text in enumerate(unique)}
        encoded = encoded[[number_of[text] for text in given]]
    return encoded.reshape(texts.shape)
