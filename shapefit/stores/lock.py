"""An object that only one run holds: made where there is none, kept alive, taken over when old."""

from __future__ import annotations

import os
import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from typing import Any

from shapefit.stores.opening import open_store, store_errors
from shapefit.stores.urls import UrlPath
from shapefit.stores.writing import check_target

HEARTBEAT = 60.0
"""Seconds after which the holder writes the object again."""

ABANDONED = 300.0
"""Seconds without that after which another run takes it over."""


@contextmanager
def held_object(path: UrlPath) -> Iterator[bool]:
    """Hold an object for the length of the block; give whether that was possible.

    It is made in one request that fails where it is there; a lock that is older than ABANDONED is
    replaced in one that fails where somebody else replaced it. Stores that know no such requests
    are asked first, so that two runs that begin within a moment are not noticed.
    """
    check_target(path)
    system, name = open_store(path)
    holder = f"{socket.gethostname()} {os.getpid()}\n".encode()
    with store_errors(path, "written"):
        held = _make(system, name, holder) or _take_over(system, name, holder)
    if not held:
        yield False
        return
    ended = threading.Event()
    heart = threading.Thread(target=_beat, args=(system, name, holder, ended), daemon=True)
    heart.start()
    try:
        yield True
    finally:
        ended.set()
        heart.join()
        with suppress(Exception):  # a lock that stays is abandoned soon
            system.rm_file(name)


def _make(system: Any, name: str, holder: bytes) -> bool:
    """Make the object; return whether there was none."""
    try:
        system.pipe_file(name, holder, mode="create")
    except FileExistsError:
        return False
    except (NotImplementedError, TypeError, ValueError):
        if system.exists(name):
            return False
        system.pipe_file(name, holder)
    return True


def _take_over(system: Any, name: str, holder: bytes) -> bool:
    """Replace the object of a run that was killed; return whether it was one."""
    try:
        known = system.info(name)
        age = (datetime.now(UTC) - system.modified(name)).total_seconds()
    except FileNotFoundError:  # the other run has just ended
        return _make(system, name, holder)
    if age < ABANDONED:
        return False
    if "ETag" not in known:
        system.pipe_file(name, holder)
        return True
    try:
        system.pipe_file(name, holder, IfMatch=known["ETag"])
    except OSError:  # another run has just done the same
        return False
    return True


def _beat(system: Any, name: str, holder: bytes, ended: threading.Event) -> None:
    while not ended.wait(HEARTBEAT):
        with suppress(Exception):  # the next one may come through
            system.pipe_file(name, holder)
