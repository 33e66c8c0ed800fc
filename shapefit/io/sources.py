"""What an input path points at: standard input, or a file that can be read."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import nullcontext
from pathlib import Path

from shapefit.errors import input_error

HDF5_SIGNATURE = b"\x89HDF\r\n\x1a\n"
PARQUET_SIGNATURE = b"PAR1"
STREAM = "-"

BLOCK_BYTES = 1 << 16
"""Of text that are read at a time; larger blocks leave the processor's cache and take longer."""


def is_stream(path: Path) -> bool:
    """Whether the path is `-`: standard input or output."""
    return str(path) == STREAM


def source_name(path: Path) -> str:
    """Name of the input in messages."""
    return "standard input" if is_stream(path) else str(path)


def require_file(path: Path) -> None:
    """Raise InputError unless `path` is a file that can be read and is not empty."""
    if not os.path.exists(path):
        raise input_error(path, "there is no such file", _missing_fix(path))
    if os.path.isdir(path):
        raise input_error(path, "it is a folder", f"name the files in it, e.g. '{path}/*.h5'")
    if not os.access(path, os.R_OK, effective_ids=os.access in os.supports_effective_ids):
        raise input_error(path, "may not be read", "change its permissions")
    if path.is_file() and path.stat().st_size == 0:
        raise input_error(path, "is empty (0 bytes)", "make or copy the file again")


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


def _missing_fix(path: Path) -> str:
    folder = path.parent
    while not os.path.exists(folder):
        folder = folder.parent
    if folder != path.parent:
        return f"check the path ({folder} exists, what follows does not)"
    return "check its name"
