"""Local copies of objects, for all that reads files of this machine only."""

from __future__ import annotations

import errno
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

from shapefit.errors import input_error
from shapefit.stores.opening import open_store, store_errors
from shapefit.stores.shelf import current_shelf
from shapefit.stores.states import find_state
from shapefit.stores.urls import UrlPath

_NO_ROOM = frozenset({errno.ENOSPC, errno.EDQUOT})


def local_copy(path: UrlPath) -> Path:
    """Return a copy of an object on this machine, downloaded the first time.

    Raises InputError where that is not possible.
    """
    shelf = current_shelf()
    if path not in shelf.copies:
        find_state(path)  # by which it is known later whether the copy is still good
        system, name = open_store(path)
        with store_errors(path), _room_for(path):
            copy = shelf.place_for(path)
            system.get_file(name, str(copy))
        shelf.copies[path] = copy
    return shelf.copies[path]


def keep_copies(paths: Iterable[Path]) -> None:
    """Download objects that will be read whole, and more than once; leave out other paths."""
    for path in paths:
        if isinstance(path, UrlPath):
            local_copy(path)


def has_copy(path: UrlPath) -> bool:
    """Whether an object was downloaded before."""
    return path in current_shelf().copies


@contextmanager
def _room_for(path: UrlPath) -> Iterator[None]:
    """Say of a full disk which one it is."""
    try:
        yield
    except OSError as error:
        if error.errno not in _NO_ROOM:
            raise
        found = f"has no room for a copy of {path} ({error.strerror})"
        fix = "free some space, or set TMPDIR to another folder"
        raise input_error(tempfile.gettempdir(), found, fix) from error
