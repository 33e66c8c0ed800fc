"""Whether a file is there, here or in a store, and by what a change of it is known."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path

from shapefit.stores.opening import open_store, store_errors
from shapefit.stores.shelf import State, current_shelf
from shapefit.stores.urls import UrlPath

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
