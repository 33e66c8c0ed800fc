"""What is known of objects, and their local copies, for as long as they are needed."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO

from shapefit.stores.urls import UrlPath

State = tuple[int, int | str]
"""Bytes of a file, and by what else a change of it is known: time, or the etag of an object."""

MOST_OPEN = 2
"""Objects whose blocks are kept."""


@dataclass
class Shelf:
    """States and copies of objects, and those that are open; the copies are removed with it."""

    states: dict[UrlPath, State] = field(default_factory=dict)
    copies: dict[UrlPath, Path] = field(default_factory=dict)
    opened: dict[UrlPath, IO[bytes]] = field(default_factory=dict)
    folder: tempfile.TemporaryDirectory[str] | None = None

    def remember(self, path: UrlPath, state: State | None) -> None:
        """Note the state of an object; drop what is known of it if that was another one."""
        if path in self.states and self.states[path] != state:
            self.forget(path)
        if state is not None:
            self.states[path] = state

    def keep_open(self, path: UrlPath, file: IO[bytes]) -> None:
        """Keep an open object, and let go of the first one beyond a few."""
        self.opened[path] = file
        if len(self.opened) > MOST_OPEN:
            del self.opened[next(iter(self.opened))]

    def place_for(self, path: UrlPath) -> Path:
        """Return where a new copy goes, in a folder of its own, under the name of the object."""
        if self.folder is None:
            self.folder = tempfile.TemporaryDirectory(prefix="shapefit-copies-")
        return Path(tempfile.mkdtemp(dir=self.folder.name)) / path.name

    def forget(self, path: UrlPath) -> None:
        """Drop what is known of an object that changed, or may have."""
        self.states.pop(path, None)
        self.opened.pop(path, None)
        copy = self.copies.pop(path, None)
        if copy is not None:
            copy.unlink(missing_ok=True)


_own: ContextVar[Shelf | None] = ContextVar("shelf", default=None)
_OF_THE_PROCESS = Shelf()


def current_shelf() -> Shelf:
    """Return what this thread knows."""
    return _own.get() or _OF_THE_PROCESS


@contextmanager
def own_shelf() -> Iterator[None]:
    """Know nothing of any object at the start, and remove in the end what is copied within."""
    shelf = Shelf()
    token = _own.set(shelf)
    try:
        yield
    finally:
        _own.reset(token)
        if shelf.folder is not None:
            shelf.folder.cleanup()
