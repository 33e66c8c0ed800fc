"""Local copies of what stores hold, and what is known of it, for as long as it is needed."""

from __future__ import annotations

import errno
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field
from pathlib import Path

from shapefit.errors import input_error
from shapefit.stores.opening import open_store, store_errors
from shapefit.stores.urls import UrlPath

State = tuple[int, int | str]
"""Bytes of a file, and by what else a change of it is known: time, or the etag of an object."""


_NO_ROOM = frozenset({errno.ENOSPC, errno.EDQUOT})


@dataclass
class Shelf:
    """States and copies of objects; the copies are removed with it."""

    states: dict[UrlPath, State] = field(default_factory=dict)
    copies: dict[UrlPath, Path] = field(default_factory=dict)
    folder: tempfile.TemporaryDirectory[str] | None = None

    def place_for(self, path: UrlPath) -> Path:
        """Return where a new copy goes, in a folder of its own, under the name of the object."""
        if self.folder is None:
            self.folder = tempfile.TemporaryDirectory(prefix="shapefit-copies-")
        return Path(tempfile.mkdtemp(dir=self.folder.name)) / path.name


_shelf: ContextVar[Shelf | None] = ContextVar("shelf", default=None)
_OF_THE_PROCESS = Shelf()


@contextmanager
def own_copies() -> Iterator[None]:
    """Know nothing of any object at the start, and remove in the end what is copied within."""
    shelf = Shelf()
    token = _shelf.set(shelf)
    try:
        yield
    finally:
        _shelf.reset(token)
        if shelf.folder is not None:
            shelf.folder.cleanup()


def local_copy(path: UrlPath) -> Path:
    """Return a copy of an object on this machine, downloaded the first time.

    Raises InputError where that is not possible.
    """
    shelf = current_shelf()
    if path not in shelf.copies:
        system, name = open_store(path)
        with store_errors(path), _room_for(path):
            copy = shelf.place_for(path)
            system.get_file(name, str(copy))
        shelf.copies[path] = copy
    return shelf.copies[path]


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
        raise input_error(tempfile.gettempdir(), found, fix) from None


def keep_copies(paths: Iterable[Path]) -> None:
    """Download objects that will be read whole, and more than once; leave out other paths."""
    for path in paths:
        if isinstance(path, UrlPath):
            local_copy(path)


def has_copy(path: UrlPath) -> bool:
    """Whether an object was downloaded before."""
    return path in current_shelf().copies


def forget(path: UrlPath) -> None:
    """Drop what is known of an object that changed, or may have."""
    shelf = current_shelf()
    shelf.states.pop(path, None)
    copy = shelf.copies.pop(path, None)
    if copy is not None:
        copy.unlink(missing_ok=True)


def current_shelf() -> Shelf:
    """Return what this thread knows."""
    return _shelf.get() or _OF_THE_PROCESS
