"""How much memory there is: what does not fit is refused before it is asked for."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

from shapefit.errors import input_error

ALWAYS_FITS = 1 << 26
"""Bytes that nobody needs to ask for."""

PROCESS, MACHINE = Path("/proc/self"), Path("/proc/meminfo")
GROUPS = Path("/sys/fs/cgroup")


def check_fits(
    place: str,
    size: int,
    found: str = "it",
    fix: str = "divide the file, or use a machine with more memory",
) -> None:
    """Raise InputError at `place` where `size` bytes are more than the memory that is free."""
    if size <= ALWAYS_FITS:
        return
    free = free_memory()
    if free is not None and size > free:
        taken = f"{found} takes {in_words(size)} of memory, and {in_words(free)} are free"
        raise input_error(place, taken, fix)


def free_memory() -> int | None:
    """Bytes that this process can still get, None where the system does not report it."""
    return min(_limits(), default=None)


def in_words(size: int) -> str:
    """Return a number of bytes as a person reads it: 6.7 GB."""
    value, unit = float(size), "bytes"
    for larger in ("kB", "MB", "GB", "TB", "PB"):
        if value < 1000:
            break
        value, unit = value / 1000, larger
    return f"{value:.3g} {unit}"


def _limits() -> Iterator[int]:
    """Yield what is left of each limit: the machine's, the process's, and its group's."""
    with suppress(OSError, ValueError, IndexError):
        for line in MACHINE.read_text().splitlines():
            if line.startswith("MemAvailable:"):
                yield int(line.split()[1]) * 1024
    with suppress(ImportError, OSError, ValueError):
        import resource

        soft, _ = resource.getrlimit(resource.RLIMIT_AS)
        if soft != resource.RLIM_INFINITY:
            pages = int((PROCESS / "statm").read_text().split()[0])
            yield max(soft - pages * os.sysconf("SC_PAGE_SIZE"), 0)
    with suppress(OSError, ValueError):
        for line in (PROCESS / "cgroup").read_text().splitlines():
            group = GROUPS / line.rpartition("::")[2].lstrip("/")
            limit = (group / "memory.max").read_text().strip()
            if limit != "max":
                yield max(int(limit) - int((group / "memory.current").read_text()), 0)
