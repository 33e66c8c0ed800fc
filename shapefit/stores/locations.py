"""What a text names: a file of this machine, or an object of a store; and which objects there are.

One request lists a thousand objects.
"""

from __future__ import annotations

from collections.abc import Generator
from pathlib import Path
from typing import Any, Self
from urllib.parse import unquote, urlsplit

from shapefit.stores.opening import open_store, store_errors
from shapefit.stores.shelf import State, current_shelf, find_state, local_copy, state_of
from shapefit.stores.urls import UrlPath, is_url


def matching(pattern: UrlPath) -> tuple[UrlPath, ...]:
    """Return the objects that a glob names, sorted by name; their states are remembered."""
    system, name = open_store(pattern)
    with store_errors(pattern):
        found = system.glob(name, detail=True)
    return tuple(sorted(_taken(pattern, system, found)))


def objects_in(folder: UrlPath) -> dict[str, State]:
    """Return the names of the objects right below a URL, with their states."""
    system, name = open_store(folder)
    with store_errors(folder):
        found = system.find(name, maxdepth=1, detail=True)
    return {path.name: state for path, state in _taken(folder, system, found).items()}


def _taken(asked: UrlPath, system: Any, found: dict[str, dict[str, Any]]) -> dict[UrlPath, State]:
    """Return objects that a store lists, as URLs like the one that was asked for."""
    objects = {}
    for name, entry in found.items():
        if entry["type"] != "directory":
            bare = str(system.unstrip_protocol(name)).partition("://")[2]
            path = type(asked)(f"{asked.scheme}://{bare}")
            objects[path] = state_of(entry)
            current_shelf().remember(path, objects[path])
    return objects


def files_in(folder: Path) -> dict[str, int]:
    """Return the names of the files in a folder, here or in a store, with their bytes."""
    if isinstance(folder, UrlPath):
        return {name: state[0] for name, state in objects_in(folder).items()}
    try:
        return {path.name: path.stat().st_size for path in folder.iterdir() if path.is_file()}
    except FileNotFoundError:
        return {}


class ObjectPath(UrlPath):
    """The URL of an object. Where a file of this machine is asked for, it gives a local copy.

    So Python and libraries read it as they read files; it is downloaded when it is first asked
    for. What writes, and what reads an object piece by piece, knows URLs by itself.
    """

    def __fspath__(self) -> str:
        """Return the path of a local copy."""
        return str(local_copy(self))

    def is_file(self) -> bool:
        """Whether there is such an object."""
        return find_state(self) is not None

    def iterdir(self) -> Generator[Self, None, None]:
        """Yield the objects right below the URL."""
        yield from (self / name for name in objects_in(self))


def location(text: str) -> Path:
    """Return the path of a text: of a URL, or of this machine (`file://` too)."""
    if not is_url(text):
        return Path(text)
    scheme, _, rest = text.partition("://")
    if scheme.lower() == "file":
        return Path(unquote(urlsplit(text).path))
    return ObjectPath(f"{scheme.lower()}://{rest}")
