"""What an input path points at: standard input, or a file that can be read and fits in
memory.
"""

from __future__ import annotations

import gzip
import hashlib
import os
import stat
import sys
import zlib
from collections.abc import Iterator, Mapping
from contextlib import nullcontext, suppress
from functools import partial
from io import BufferedReader, BytesIO
from pathlib import Path
from typing import cast

from shapefit.errors import InputError, input_error

HDF5_SIGNATURE = b"\x89HDF\r\n\x1a\n"
GZIP_SIGNATURE = b"\x1f\x8b"
BYTE_ORDER_MARK = b"\xef\xbb\xbf"
UTF16_MARKS = (b"\xff\xfe", b"\xfe\xff")

BLOCK_BYTES = 1 << 18
"""Of text that are read at a time: with a quarter of them a table takes a tenth longer,
and larger blocks leave the processor's cache.
"""

WHOLE_BLOCK_BYTES = 1 << 20
"""Of a file that is read whole: memory is asked for at each."""

MAX_READ_BYTES = 1 << 30
"""Bytes of a file that is read whole, at most."""

ALWAYS_FITS = 1 << 26
"""Bytes that nobody needs to ask for."""

MAX_INFLATION = 200
"""Times its size that a compressed file, or a chunk of HDF5, may hold: landmarks become
10 times smaller, where most are absent 100 times.
"""

CGROUP = Path("/sys/fs/cgroup")
"""Limits of the container that a process is in, if it is in one."""


State = tuple[int, int]
"""Size and time of change of a file; of a folder, a number for those of its files."""


def is_stream(path: Path) -> bool:
    """Whether the path is `-`: standard input or output."""
    return str(path) == "-"


def source_name(path: Path) -> str:
    """Return the name of an input in messages: its path, or `standard input`."""
    return "standard input" if is_stream(path) else str(path)


def read_head(path: Path, size: int) -> bytes:
    """Return the first `size` bytes of a file; InputError where it cannot be read."""
    try:
        with path.open("rb") as file:
            return file.read(size)
    except OSError as error:
        fix = "name a file that can be read, or copy it from where it is whole"
        reason = os.strerror(error.errno) if error.errno else str(error)
        raise input_error(path, f"cannot be read ({reason})", fix) from error


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


def find_state(path: Path) -> State:
    """Return size in bytes and time of change (ns) of a file, (0, 0) if there is none.

    What is no file, such as a pipe, has zeros, too. Of a folder it is all bytes, and a
    number that another name, size or time of a file in it makes another one. Hidden
    files do not count, as one may be a result that is being written there.
    """
    try:
        if path.is_dir():
            shown = (file for file in path.iterdir() if not file.name.startswith("."))
            states = sorted((f.name, find_state(f)) for f in shown if not f.is_dir())
            total = sum(size for _, (size, _) in states)
            summary = hashlib.sha256(repr(states).encode()).digest()
            return total, int.from_bytes(summary[:7])
        state = path.stat()
    except OSError:
        return 0, 0
    if not stat.S_ISREG(state.st_mode):
        return 0, 0
    return state.st_size, state.st_mtime_ns


def check_unchanged(states: Mapping[Path, State]) -> None:
    """Raise InputError for files whose size or time of change is not as in `states`."""
    fault = "changed while it was read, so that the result would be of two states"
    fix = "run the command again when it is complete"
    changed = [path for path, state in states.items() if find_state(path) != state]
    if changed:
        raise InputError(
            problem
            for path in changed
            for problem in input_error(path, fault, fix).problems
        )


def read_text_blocks(path: Path, *, live: bool = False) -> Iterator[bytes]:
    """Yield the bytes of standard input, a pipe or a text file, block by block.

    With `live` a block of standard input is what has come. Raises InputError where
    there are none, and where they are HDF5.
    """
    name = source_name(path)
    if live:
        assert is_stream(path), "nothing else stays open"
        stdin = _open_stdin()
        blocks = iter(partial(stdin.read1, BLOCK_BYTES), b"")
    else:
        blocks = _read_blocks(path, BLOCK_BYTES)
    first = next(blocks, b"")
    if not first:
        raise input_error(name, "is empty (0 bytes)", "write a CSV with a header line")
    if first.startswith(HDF5_SIGNATURE):
        fault = "is HDF5, which cannot come through a pipe"
        raise input_error(name, fault, "name the file itself, or send CSV")
    yield first
    yield from blocks


def read_whole(path: Path) -> bytes:
    """Return the bytes of a text file, gunzipped; InputError where it is too large."""
    text = BytesIO()
    for block in _read_blocks(path, WHOLE_BLOCK_BYTES):
        text.write(block)
        check_fits(str(path), text.tell())
        if text.tell() > MAX_READ_BYTES:
            largest = format_bytes(MAX_READ_BYTES)
            fault = f"holds more than {largest} of text, and it is read whole"
            raise input_error(path, fault, "divide it into smaller files")
    return text.getvalue()


def _read_blocks(path: Path, block_bytes: int) -> Iterator[bytes]:
    """Yield the bytes of a file or standard input in blocks, gunzipped if it is gzip.

    Raises InputError for text that cannot be unpacked, and at the place where it has
    become too large for the bytes that were read of its file.
    """
    with nullcontext(_open_stdin()) if is_stream(path) else path.open("rb") as file:
        if not _is_gzip(path):
            yield from iter(partial(file.read, block_bytes), b"")
            return
        size, unpacked = 0, gzip.GzipFile(fileobj=file)
        try:
            for block in iter(partial(unpacked.read, block_bytes), b""):
                size += len(block)
                check_unpacked(path, size, file.tell())
                yield block
        except (gzip.BadGzipFile, EOFError, zlib.error) as error:
            fix = "the file may be cut off or damaged: copy or make it again"
            raise input_error(path, f"cannot be unpacked ({error})", fix) from error


def _open_stdin() -> BufferedReader:
    """Return the bytes of standard input; InputError where the shell has closed it."""
    if sys.stdin is None:
        raise input_error("standard input", "is closed", "name a file to read instead")
    return cast(BufferedReader, sys.stdin.buffer)


def _is_gzip(path: Path) -> bool:
    """Whether a regular file is gzip; False for pipes, which are not read."""
    return path.is_file() and read_head(path, 2) == GZIP_SIGNATURE


def check_fits(place: str, size: int, subject: str = "it") -> None:
    """Raise InputError at `place` if `size` bytes are more than the free memory.

    The subject is that of the message.
    """
    if size <= ALWAYS_FITS:
        return
    free = free_memory()
    if size > max(ALWAYS_FITS, free):
        needed = f"{subject} takes {format_bytes(size)} of memory"
        fault = f"{needed}, and {format_bytes(free)} are free"
        raise input_error(
            place, fault, "divide the file, or use a machine with more memory"
        )


def check_unpacked(place: str | Path, size: int, packed: int) -> None:
    """Raise InputError at `place` if `packed` bytes inflate to too many (`size`)."""
    if size > max(ALWAYS_FITS, MAX_INFLATION * packed):
        fault = f"{format_bytes(packed)} of it become {format_bytes(size)} or more"
        raise input_error(place, fault, "unpack it, and name what was in it")


def free_memory() -> int:
    """Return the bytes of memory that this process can still get.

    Those of the machine, of its container, and below its own limit (`ulimit -v`). A
    system that does not say it, as Windows, is taken to have what is asked for.
    """
    if not hasattr(os, "sysconf"):
        return sys.maxsize
    page = os.sysconf("SC_PAGE_SIZE")
    free = [os.sysconf("SC_PHYS_PAGES") * page]
    with suppress(OSError, ValueError, IndexError):  # other systems have no /proc
        text = Path("/proc/meminfo").read_text()
        free.append(int(text.partition("MemAvailable:")[2].split()[0]) << 10)
    with suppress(OSError, ValueError):  # "max" is no number
        limit = int((CGROUP / "memory.max").read_text())
        used = int((CGROUP / "memory.current").read_text())
        free.append(limit - used)
    with suppress(ImportError, OSError, ValueError, IndexError):
        import resource

        limit, _ = resource.getrlimit(resource.RLIMIT_AS)
        if limit != resource.RLIM_INFINITY:
            used = int(Path("/proc/self/statm").read_text().split()[0]) * page
            free.append(limit - used)
    return max(0, min(free))


def format_bytes(size: int) -> str:
    """Return a number of bytes as a person reads it: 6.7 GB."""
    units = ("bytes", "kB", "MB", "GB", "TB", "PB")
    rounded = int(float(f"{size:.3g}"))
    power = min((len(str(rounded)) - 1) // 3, len(units) - 1)
    return f"{rounded / 1000**power:.3g} {units[power]}"
