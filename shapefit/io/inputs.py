"""What an input path points at: standard input, or a file that can be read and fits in
memory.
"""

from __future__ import annotations

import gzip
import os
import sys
import zlib
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from functools import partial
from pathlib import Path
from typing import IO, cast

from shapefit.errors import input_error

HDF5_SIGNATURE = b"\x89HDF\r\n\x1a\n"
GZIP_SIGNATURE = b"\x1f\x8b"
BYTE_ORDER_MARK = b"\xef\xbb\xbf"
UTF16_MARKS = (b"\xff\xfe", b"\xfe\xff")

BLOCK_BYTES = 1 << 16
"""Of text that are read at a time; larger blocks leave the processor's cache and take
longer.
"""

LARGEST_BYTES = 1 << 30
"""Of a file that is read whole."""

ALWAYS_FITS = 1 << 26
"""Bytes that nobody needs to ask for."""

MEMORY = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
"""Bytes of memory of this machine."""


def is_stream(path: Path) -> bool:
    """Whether the path is `-`: standard input or output."""
    return str(path) == "-"


def source_name(path: Path) -> str:
    """Name of the input in messages."""
    return "standard input" if is_stream(path) else str(path)


def read_head(path: Path, size: int) -> bytes:
    """Return the first bytes of a file."""
    with path.open("rb") as file:
        return file.read(size)


def require_file(path: Path) -> None:
    """Raise InputError unless `path` is a file that can be read and is not empty."""
    if not path.exists():
        raise input_error(path, "there is no such file", "check the path")
    if path.is_dir():
        raise input_error(
            path, "it is a folder", f"name the files in it, e.g. '{path}/*.h5'"
        )
    if not os.access(path, os.R_OK):
        raise input_error(path, "may not be read", "change its permissions")
    if path.is_file() and path.stat().st_size == 0:
        raise input_error(path, "is empty (0 bytes)", "make or copy the file again")


def read_text_blocks(path: Path) -> Iterator[bytes]:
    """Yield the bytes of standard input, a pipe or a file, block by block.

    Raises InputError where there are none, and where they are HDF5.
    """
    name = source_name(path)
    with nullcontext(sys.stdin.buffer) if is_stream(path) else _open_text(path) as file:
        block = file.read(BLOCK_BYTES)
        if not block:
            raise input_error(
                name, "is empty (0 bytes)", "write a CSV with a header line"
            )
        if block.startswith(HDF5_SIGNATURE):
            fault = "is HDF5, which cannot come through a pipe"
            raise input_error(name, fault, "name the file itself, or send CSV")
        yield block
        yield from iter(partial(file.read, BLOCK_BYTES), b"")


def read_whole(path: Path) -> bytes:
    """Return the bytes of a file of text. Raises InputError where it is too large for
    that.
    """
    with _open_text(path) as file:
        text = file.read(LARGEST_BYTES + 1)
    if len(text) > LARGEST_BYTES:
        fault = (
            f"holds more than {in_words(LARGEST_BYTES)} of text, and it is read whole"
        )
        raise input_error(path, fault, "divide it into smaller files")
    return text


@contextmanager
def _open_text(path: Path) -> Iterator[IO[bytes]]:
    """Open the bytes of a file of text, also of one that gzip made smaller."""
    packed = (
        path.is_file() and read_head(path, 2) == GZIP_SIGNATURE
    )  # pipes are left alone
    with cast(IO[bytes], gzip.open(path)) if packed else path.open("rb") as file:
        try:
            yield file
        except (gzip.BadGzipFile, EOFError, zlib.error) as error:
            fix = "the file may be cut off or damaged: copy or make it again"
            raise input_error(path, f"cannot be unpacked ({error})", fix) from error


def check_fits(place: str, size: int, what: str = "it") -> None:
    """Raise InputError at `place` where `size` bytes are more than this machine has
    memory.
    """
    if size > max(ALWAYS_FITS, MEMORY):
        fault = (
            f"{what} takes {in_words(size)} of memory, and this machine has"
            f" {in_words(MEMORY)}"
        )
        raise input_error(
            place, fault, "divide the file, or use a machine with more memory"
        )


def in_words(size: int) -> str:
    """Return a number of bytes as a person reads it: 6.7 GB."""
    units = ("bytes", "kB", "MB", "GB", "TB", "PB")
    power = min((len(str(size)) - 1) // 3, len(units) - 1)
    return f"{size / 1000**power:.3g} {units[power]}"
