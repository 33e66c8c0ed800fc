"""An HDF5 file opened for reading, here or piece by piece in an object store."""

from __future__ import annotations

import gc
import threading
from pathlib import Path
from typing import Any

import h5py

from shapefit.errors import input_error, printable
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
        file = _RemoteFile(path, cache_bytes)
    else:
        try_opening(path)
        file = h5py.File(path, "r", rdcc_nbytes=cache_bytes)
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
    file.id.links.visit(lambda name, info: links.append((name, info.type)), info=True)

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
