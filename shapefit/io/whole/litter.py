"""Temporary files of runs that were killed: known by their names, and by a lock that nobody holds.

Every run locks its temporaries; the system lets go of the lock when the run ends, however it ends.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

try:
    import fcntl
except ImportError:  # without such locks litter stays
    fcntl = None  # type: ignore[assignment]

Remove = Callable[[Path], object]


def lock(descriptor: int) -> None:
    """Lock an open file until it is closed; nothing where the file system has no locks."""
    if fcntl is not None:
        with suppress(OSError):
            fcntl.flock(descriptor, fcntl.LOCK_EX)


def lock_new(make: Callable[[], Path]) -> tuple[Path, int]:
    """Make a temporary and lock it; return its path and the descriptor that holds the lock.

    Another run may take it for litter before it is locked: then the next is made.
    """
    while True:
        path = make()
        with suppress(FileNotFoundError):
            descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
            lock(descriptor)
            if _stands_at(path, descriptor):
                return path, descriptor
            os.close(descriptor)


def remove_litter(folder: Path, start: str, end: str, remove: Remove) -> None:
    """Have `remove` take away what killed runs left in the folder under `start`XXXXXXXX`end`."""
    pattern = re.compile(re.escape(start) + r"[a-z0-9_]{8}" + re.escape(end))
    with suppress(OSError):
        names = [name for name in os.listdir(folder) if pattern.fullmatch(name)]
        for path in (folder / name for name in names):
            with suppress(OSError), _abandoned(path) as abandoned:
                if abandoned:
                    remove(path)


@contextmanager
def _abandoned(path: Path) -> Iterator[bool]:
    """Tell whether no run holds the lock of a temporary; hold it meanwhile."""
    descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC | os.O_NOFOLLOW)
    try:
        yield _try_lock(descriptor) and _stands_at(path, descriptor)
    finally:
        os.close(descriptor)


def _try_lock(descriptor: int) -> bool:
    if fcntl is None:
        return False
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        return False
    return True


def _stands_at(path: Path, descriptor: int) -> bool:
    try:
        return os.path.samestat(os.lstat(path), os.fstat(descriptor))
    except FileNotFoundError:
        return False
