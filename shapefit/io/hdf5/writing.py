"""Write records to an HDF5 file in chunks."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from io import FileIO
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import h5py
import numpy as np

from shapefit import core
from shapefit.errors import InputError
from shapefit.io.hdf5.trial import mark_written
from shapefit.io.layout import PER_ITEM_FLAG, VERSION, Layout, stored_name
from shapefit.io.stored.writer import Array, StoredWriter, as_stored, check_alike, storable
from shapefit.io.whole.atomic import atomic_file, write_all
from shapefit.stores.urls import UrlPath

PAGE = 1 << 16


class Spool:
    """A binary file that never fails before the eyes of HDF5, and holds all that was written.

    HDF5 crashes on a file that is shorter than it believes, and when it cannot close one. So the
    first error is kept in `error`, for the writer to raise, and from then on whatever is written
    stays in memory, page by page, and is read from there. The writer looks at `error` after every
    dataset, so that this is little.
    """

    def __init__(self, file: FileIO) -> None:
        self._file = file
        self._pages: dict[int, bytearray] = {}
        self._position = 0
        self._size = 0
        self.error: OSError | InputError | None = None

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        """Go to a place in the file; returns it."""
        if self.error is None:
            return self._file.seek(offset, whence)
        start = {os.SEEK_SET: 0, os.SEEK_CUR: self._position, os.SEEK_END: self._size}[whence]
        self._position = start + offset
        return self._position

    def tell(self) -> int:
        """Return the place in the file."""
        return self._file.tell() if self.error is None else self._position

    def read(self, size: int) -> bytes:
        """Return `size` bytes, or as many as there are; h5py knows a file by this."""
        buffer = bytearray(size)
        return bytes(buffer[: self.readinto(memoryview(buffer))])

    def readinto(self, buffer: memoryview) -> int:
        """Fill the buffer, or as much of it as there is in the file."""
        if self.error is None:
            return self._file.readinto(buffer) or 0
        target = memoryview(buffer).cast("B")[: max(self._size - self._position, 0)]
        target[:] = b"".join(self._parts(self._position, len(target)))
        self._position += len(target)
        return len(target)

    def write(self, data: memoryview) -> int:
        """Write all of `data`, to memory after an error."""
        place = self.tell()
        if not self._attempt(lambda: write_all(self._file, data)):
            self._keep(place, memoryview(data).cast("B"))
        return len(data)

    def truncate(self, size: int) -> int:
        """Cut or extend the file to `size` bytes."""
        if not self._attempt(lambda: self._file.truncate(size)):
            self._size = size
        return size

    def flush(self) -> None:
        """Do nothing: the file is unbuffered."""

    def _attempt(self, action: Callable[[], object]) -> bool:
        """Do something to the file unless it failed before; return whether that went well."""
        if self.error is None:
            try:
                action()
            except (OSError, InputError) as error:
                self.error = error
                self._size = os.fstat(self._file.fileno()).st_size
        return self.error is None

    def _keep(self, place: int, data: memoryview) -> None:
        for part in self._parts(place, len(data)):
            part[:], data = data[: len(part)], data[len(part) :]
            place += len(part)
        self._position, self._size = place, max(self._size, place)

    def _parts(self, start: int, size: int) -> Iterator[memoryview]:
        """Yield so many bytes of the pages from a place on, to read and write."""
        while size:
            page, offset = divmod(start, PAGE)
            part = memoryview(self._page(page))[offset : offset + size]
            yield part
            start, size = start + len(part), size - len(part)

    def _page(self, number: int) -> bytearray:
        """Return a page to read and write: as in the file, zero beyond its end."""
        if number not in self._pages:
            stored = os.pread(self._file.fileno(), PAGE, number * PAGE)
            self._pages[number] = bytearray(stored.ljust(PAGE, b"\0"))
        return self._pages[number]


CHUNK_BYTES = 1 << 18
CHUNK_ROWS = 64
FEWEST_WRITTEN = 1024
"""Items that are written at a time, but for the last: small files come by a hundred."""

CACHE_BYTES = 4 * CHUNK_BYTES
"""Of chunks that HDF5 keeps for each dataset; by default 8 MB, and rows are only appended."""

COMPRESSION = {"compression": "gzip", "compression_opts": 1}
"""Of datasets that are mostly 0: a row of 64 shrinks to a fifth, and `deflated` takes no time."""


@contextmanager
def hdf5_output(target: Path, form: Layout) -> Iterator[Hdf5Writer]:
    """Give a writer to a file that appears on a clean exit."""
    with atomic_file(target) as file, Hdf5Writer(file, form) as writer:
        yield writer
    if not isinstance(target, UrlPath):
        mark_written(target)


class Hdf5Writer(StoredWriter):
    """Appends records of one layout to an HDF5 file; a context manager.

    Datasets per item are chunked and extended along their first axis; `attributes` become root
    attributes on exit.
    """

    def __init__(self, file: FileIO, form: Layout) -> None:
        super().__init__(form)
        self._datasets: dict[str, Any] = {}
        self._chunks: dict[str, tuple[int, np.dtype[Any]]] = {}
        self._written: dict[str, int] = {}
        self._shapes: dict[str, tuple[int, ...]] = {}
        self._waiting: dict[str, list[Array]] = {}
        self._held = 0
        self._begun = False
        self._spool = Spool(file)
        self._file = h5py.File(self._spool, "w", rdcc_nbytes=CACHE_BYTES)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        with self._spool_errors():
            try:
                if kind is None:
                    self._finish()
            finally:
                self._file.close()

    def _write_items(self, record: Any, further: Mapping[str, Array]) -> None:
        rows = {
            dataset.name: as_stored(dataset, getattr(record, dataset.attribute))
            for dataset in self._form.growing
            if getattr(record, dataset.attribute) is not None
        }
        rows |= {name: storable(values) for name, values in further.items()}
        shapes = {name: values.shape[1:] for name, values in rows.items()}
        self._shapes = self._shapes or shapes
        check_alike(shapes, self._shapes)
        for name, values in rows.items():
            self._waiting.setdefault(name, []).append(values)
        self._held += len(rows.get("item", ()))
        if self._held >= FEWEST_WRITTEN:
            self._write_waiting()

    def _write_waiting(self, *, last: bool = False) -> None:
        """Write the rows that wait; of numbers those that fill chunks, before the last."""
        self._held = 0
        rows = {name: np.concatenate(values) for name, values in self._waiting.items()}
        with self._spool_errors():
            if not self._begun:
                self._begin(rows)
                self._check_spool()
            for name, values in rows.items():
                dataset, start = self._datasets[name], self._written[name]
                chunk, kind = self._chunks[name]
                by_chunk = values.dtype.kind != "O" and values.size > 0
                whole = len(values) // chunk * chunk if by_chunk else 0
                end = whole if by_chunk and not last else len(values)
                self._written[name] = start + end
                dataset.id.set_extent((start + end, *values.shape[1:]))
                encode = deflated if name in self._form.sparse else np.ascontiguousarray
                for at in range(0, whole, chunk):
                    place = (start + at,) + (0,) * (values.ndim - 1)
                    rows_of_it = values[at : at + chunk].astype(kind, copy=False)
                    dataset.id.write_direct_chunk(place, encode(rows_of_it))
                append_rows(dataset, start + whole, values[whole:end])
                self._waiting[name] = [values[end:]]
                self._check_spool()

    def _begin(self, rows: dict[str, Array]) -> None:
        self._begun = True
        for name, values in rows.items():
            self._datasets[name] = self._extendable(name, values)
            self._chunks[name] = self._datasets[name].chunks[0], values.dtype
            self._written[name] = 0
        for dataset in self._form.datasets:
            value = getattr(self._first, dataset.attribute)
            if value is not None and not dataset.grows:
                self._store(dataset.name, as_stored(dataset, value))
        for name, value in self._whole.items():
            self._store(name, storable(value)).attrs[PER_ITEM_FLAG] = False

    def _finish(self) -> None:
        self._check_begun()
        self._write_waiting(last=True)
        root = self._file.attrs
        root["format"] = self._form.name
        root["version"] = VERSION
        root["unit"] = self._first.unit
        if getattr(self._first, "y_axis", None) is not None:
            root["y_axis"] = self._first.y_axis
        if getattr(self._first, "frame_rate", None) is not None:
            root["frame_rate"] = self._first.frame_rate
        for name, value in self.attributes.items():
            root[stored_name(name)] = value

    def _extendable(self, name: str, values: Array) -> Any:
        rest = values.shape[1:]
        row_bytes = max(values.itemsize * int(np.prod(rest)), 1)
        rows = max(1, min(CHUNK_BYTES // row_bytes, max(len(values), CHUNK_ROWS)))
        return self._file.create_dataset(
            name,
            shape=(0, *rest),
            maxshape=(None, *(size or None for size in rest)),
            chunks=(rows, *(max(size, 1) for size in rest)),
            dtype=_file_type(values),
            **(COMPRESSION if name in self._form.sparse else {}),
        )

    def _store(self, name: str, values: Array) -> Any:
        dataset = self._file.create_dataset(name, data=values, dtype=_file_type(values))
        self._check_spool()
        return dataset

    @contextmanager
    def _spool_errors(self) -> Iterator[None]:
        """Raise the first error of the file below, whatever HDF5 made of it."""
        try:
            yield
        finally:
            self._check_spool()

    def _check_spool(self) -> None:
        if self._spool.error:
            raise self._spool.error


def append_rows(dataset: Any, start: int, values: Array) -> None:
    """Do what `dataset[start:] = values` does in twice the time, or leave texts to that."""
    if not values.size:
        return
    if values.dtype.kind == "O":
        dataset[start:] = values
    else:
        place = dataset.id.get_space()
        place.select_hyperslab((start,) + (0,) * (values.ndim - 1), values.shape)
        rows = h5py.h5s.create_simple(values.shape)
        dataset.id.write(rows, place, np.ascontiguousarray(values))


def deflated(values: Array) -> bytes:
    """Return float64 numbers, most of them 0, as HDF5 knows them by `gzip`."""
    numbers = np.ascontiguousarray(values, "<f8").reshape(-1).view(np.uint64)
    stream = np.empty(len(numbers) * 9 // 8 + 5, np.uint64)
    size = core.deflate(numbers=numbers, stream=stream)
    return stream.view(np.uint8)[:size].tobytes()


def _file_type(values: Array) -> Any:
    return h5py.string_dtype() if values.dtype.kind == "O" else values.dtype
