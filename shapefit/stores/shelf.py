"""What is known of objects, here or in a store, and their local copies, as long as needed."""

from __future__ import annotations

import errno
import os
import tempfile
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from contextvars import Context, ContextVar, copy_context
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, TypeVar

from shapefit.errors import input_error
from shapefit.stores.opening import open_store, store_errors
from shapefit.stores.urls import UrlPath

State = tuple[int, int | str]
"""Bytes of a file, and by what else a change of it is known: time, or the etag of an object."""

MOST_OPEN = 2
"""Objects whose blocks are kept."""

THREADS = 16
"""That ask disks and stores, which answer several as fast as one."""

Thing = TypeVar("Thing")
Answer = TypeVar("Answer")


@dataclass
class Shelf:
    """States and copies of objects, and those that are open; the copies are removed with it."""

    states: dict[UrlPath, State] = field(default_factory=dict)
    copies: dict[UrlPath, Path] = field(default_factory=dict)
    opened: dict[UrlPath, IO[bytes]] = field(default_factory=dict)
    folder: tempfile.TemporaryDirectory[str] | None = None
    making: threading.Lock = field(default_factory=threading.Lock)

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
            self.opened.pop(next(iter(self.opened)), None)  # another thread may have done it

    def place_for(self, path: UrlPath) -> Path:
        """Return where a new copy goes, in a folder of its own, under the name of the object."""
        with self.making:
            self.folder = self.folder or tempfile.TemporaryDirectory(prefix="shapefit-copies-")
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


def on_threads(ask: Callable[[Thing], Answer], things: Iterable[Thing]) -> list[Answer]:
    """Ask something of many files at once; return the answers in order.

    The threads share what this one knows, and its options of stores.
    """
    known = list(things)
    if len(known) < 2:
        return [ask(thing) for thing in known]
    from concurrent.futures import ThreadPoolExecutor

    def adopt(own: Context) -> None:
        for variable, value in own.items():
            variable.set(value)

    with ThreadPoolExecutor(THREADS, initializer=adopt, initargs=(copy_context(),)) as pool:
        return list(pool.map(ask, known))


VERSIONS = ("ETag", "etag", "mtime", "LastModified", "created")
"""Where stores say of which version an object is, the best first."""


def look_up(path: Path) -> State | None:
    """Return the state of a file, as it is now; None where there is none.

    Raises InputError where the store does not answer.
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
    current_shelf().remember(path, state)
    return state


def find_state(path: Path) -> State | None:
    """Return the state of a file; that of an object as it was when it was looked up."""
    if isinstance(path, UrlPath) and path in current_shelf().states:
        return current_shelf().states[path]
    return look_up(path)


def state_of(entry: Mapping[str, object]) -> State:
    """Return the state in what a store says of an object."""
    version = next((entry[key] for key in VERSIONS if entry.get(key)), "")
    return int(str(entry.get("size") or 0)), str(version).strip('"')


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
