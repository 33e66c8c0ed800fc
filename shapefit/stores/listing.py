"""Objects whose names begin, or match, as a URL says; one request lists a thousand."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from shapefit.stores.opening import open_store, store_errors
from shapefit.stores.shelf import State, current_shelf
from shapefit.stores.states import state_of
from shapefit.stores.urls import UrlPath


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
