"""What a path names, here or in a store: its state, its first bytes, files to read it from."""

from __future__ import annotations

import os
from pathlib import Path
from typing import IO

from shapefit.stores.copies import State, current_shelf, forget, has_copy, local_copy
from shapefit.stores.opening import open_store, store_errors
from shapefit.stores.urls import UrlPath

BLOCK_BYTES = 1 << 20
"""Of an object that are fetched at a time where it is read piece by piece."""

MOST_BLOCKS = 32
"""Of them that are kept."""


def look_up(path: Path) -> State | None:
    """Return the state of a file, as it is now; None where there is none.

    What is known of the object from before is dropped if it changed. Raises InputError where the
    store does not answer.
    """
    if not isinstance(path, UrlPath):
        try:
            found = os.stat(path)
        except OSError:
            return None
        return found.st_size, found.st_mtime_ns
    system, name = open_store(path)
    state = None
    with store_errors(path):
        try:
            entry = system.info(name)
            state = None if entry["type"] == "directory" else state_of(entry)
        except FileNotFoundError:
            pass
    remember(path, state)
    return state


def find_state(path: Path) -> State | None:
    """Return the state of a file; that of an object as it was when it was looked up."""
    if isinstance(path, UrlPath) and path in current_shelf().states:
        return current_shelf().states[path]
    return look_up(path)


def state_of(entry: dict[str, object]) -> State:
    """Return the state in what a store says of an object."""
    keys = ("ETag", "etag", "mtime", "LastModified", "created")
    version = next((entry[key] for key in keys if entry.get(key)), "")
    return int(str(entry.get("size") or 0)), str(version).strip('"')


def remember(path: UrlPath, state: State | None) -> None:
    """Note the state of an object; drop the copy of another one."""
    states = current_shelf().states
    if states.get(path) != state:
        forget(path)
    if state is not None:
        states[path] = state


def read_head(path: Path, size: int) -> bytes:
    """Return the first bytes of a file; of an object, only these are fetched."""
    if not isinstance(path, UrlPath) or has_copy(path):
        with path.open("rb") as file:
            return file.read(size)
    system, name = open_store(path)
    with store_errors(path):
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


def for_h5py(path: Path) -> Path | IO[bytes]:
    """Return what h5py opens a file by: its path, or an object as `open_bytes` gives it."""
    if not isinstance(path, UrlPath) or has_copy(path):
        return path
    return open_bytes(path)
