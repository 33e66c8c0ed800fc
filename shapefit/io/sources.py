"""What an input path points at: standard input, or a file that can be read."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import nullcontext
from pathlib import Path

from shapefit.errors import input_error
from shapefit.io.memory import check_fits, in_words
from shapefit.stores import UrlPath, find_state, read_head

HDF5_SIGNATURE = b"\x89HDF\r\n\x1a\n"
PARQUET_SIGNATURE = b"PAR1"
STREAM = "-"

BYTE_ORDER_MARK = b"\xef\xbb\xbf"
"""With which some programs begin text in UTF-8."""

BLOCK_BYTES = 1 << 17
"""Of text that are read at a time; larger blocks leave the processor's cache and take longer."""

LARGEST_BYTES = 1 << 30
"""Of a file that is read whole."""

MEMORY_FACTOR = 14
"""Memory that parsed JSON takes, as a multiple of the file (numbers of some ten digits)."""


def is_stream(path: Path) -> bool:
    """Whether the path is `-`: standard input or output."""
    return str(path) == STREAM


def source_name(path: Path) -> str:
    """Name of the input in messages."""
    return "standard input" if is_stream(path) else str(path)


def begins_with(path: Path, *signatures: bytes) -> bool:
    """Whether a file, here or in a store, begins with one of these bytes; pipes are left alone."""
    try:
        return path.is_file() and read_head(path, 8).startswith(signatures)
    except OSError:  # who opens the file reports it
        return False


def require_file(path: Path) -> None:
    """Raise InputError unless `path` is a file that can be read and is not empty."""
    if isinstance(path, UrlPath):
        _require_object(path)
        return
    if not os.path.exists(path):
        raise input_error(path, "there is no such file", _missing_fix(path))
    if os.path.isdir(path):
        raise input_error(path, "it is a folder", f"name the files in it, e.g. '{path}/*.h5'")
    if not os.access(path, os.R_OK, effective_ids=os.access in os.supports_effective_ids):
        raise input_error(path, "may not be read", "change its permissions")
    if path.is_file() and path.stat().st_size == 0:
        raise input_error(path, "is empty (0 bytes)", "make or copy the file again")


def _require_object(path: UrlPath) -> None:
    state = find_state(path)
    if state is None:
        raise input_error(path, "there is no such object", "check its name")
    if state[0] == 0:
        raise input_error(path, "is empty (0 bytes)", "make or copy it again")


def read_text_blocks(path: Path) -> Iterator[bytes]:
    """Yield the bytes of standard input, a pipe or a file, block by block.

    Raises InputError where there are none, and where they are HDF5.
    """
    if is_stream(path) and sys.stdin is None:
        raise input_error(source_name(path), "is closed", "send data there, or name a file")
    with nullcontext(sys.stdin.buffer) if is_stream(path) else path.open("rb") as file:
        block = file.read(BLOCK_BYTES)
        if not block:
            fix = "write a CSV with a header line"
            raise input_error(source_name(path), "is empty (0 bytes)", fix)
        for name, signature in (("HDF5", HDF5_SIGNATURE), ("Parquet", PARQUET_SIGNATURE)):
            if block.startswith(signature):
                found = f"is {name}, which cannot come through a pipe"
                raise input_error(source_name(path), found, "name the file itself, or send CSV")
        while block:
            yield block
            block = file.read(BLOCK_BYTES)


def read_whole(path: Path) -> bytes:
    """Return the bytes of a file of text. Raises InputError where it is too large for that."""
    with open(path, "rb") as file:
        size = os.fstat(file.fileno()).st_size
        if size > LARGEST_BYTES:
            found = f"{in_words(size)} of text, and it is read whole"
            fix = f"divide it into files of less than {in_words(LARGEST_BYTES)}"
            raise input_error(path, found, fix)
        check_fits(str(path), MEMORY_FACTOR * size, "what it holds")
        return file.read()


def _missing_fix(path: Path) -> str:
    folder = path.parent
    while not os.path.exists(folder):
        folder = folder.parent
    if folder != path.parent:
        return f"check the path ({folder} exists, what follows does not)"
    return "check its name"
