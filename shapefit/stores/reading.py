"""Files read here or in a store, of which no more is fetched than is asked for."""

from __future__ import annotations

from pathlib import Path
from typing import IO

from shapefit.stores.opening import open_store, store_errors
from shapefit.stores.shelf import current_shelf, has_copy, local_copy, look_up
from shapefit.stores.urls import UrlPath

BLOCK_BYTES = 1 << 18
"""Of an object that are fetched at a time where it is read piece by piece.

Our HDF5 files have chunks of this size. Of 59 MB with 140,000 images, 10,000 of them (4.2 MB) take
8.7 MB in 34 requests; 6 MB in 89 with blocks of a quarter, 18 MB in 18 with blocks four times as
large.
"""

MOST_BLOCKS = 256
"""Of them that are kept: a part is read twice, once to check it."""


def read_head(path: Path, size: int) -> bytes:
    """Return the first bytes of a file; of an object, only these are fetched."""
    if not isinstance(path, UrlPath) or has_copy(path):
        with path.open("rb") as file:
            return file.read(size)
    known = current_shelf().opened.get(path)
    with store_errors(path):
        if known is not None:
            known.seek(0)
            return known.read(size)
        system, name = open_store(path)
        head: bytes = system.cat_file(name, start=0, end=size)
    return head


def read_bytes(path: Path) -> bytes:
    """Return what a file holds now. Raises FileNotFoundError where there is none."""
    if not isinstance(path, UrlPath):
        return path.read_bytes()
    if look_up(path) is None:
        raise FileNotFoundError(str(path))
    system, name = open_store(path)
    with store_errors(path):
        content: bytes = system.cat_file(name)
    return content


def open_bytes(path: Path) -> IO[bytes]:
    """Open a file to be read piece by piece, anywhere in it.

    Of an object only the blocks that are asked for are fetched, unless there is a copy of it.
    """
    if not isinstance(path, UrlPath):
        return path.open("rb")
    if has_copy(path):
        return local_copy(path).open("rb")
    system, name = open_store(path)
    with store_errors(path):
        file: IO[bytes] = system.open(
            name,
            "rb",
            block_size=BLOCK_BYTES,
            cache_type="blockcache",
            cache_options={"maxblocks": MOST_BLOCKS},
        )
    return file


def shared_bytes(path: UrlPath) -> IO[bytes]:
    """Open an object as `open_bytes` does; those who open it one after another share its blocks."""
    shelf = current_shelf()
    if path not in shelf.opened:
        shelf.keep_open(path, open_bytes(path))
    return shelf.opened[path]
