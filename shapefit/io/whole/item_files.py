"""File names for items: readable, valid on common systems, different for different items."""

from __future__ import annotations

import hashlib
from pathlib import PurePosixPath
from urllib.parse import quote

# `%` begins an escape; the others may not be part of a file's name on Windows.
ESCAPED = frozenset('%<>:"|?*\\')
# Not at the ends of a name: hidden files, `..`, and what some systems cut off.
ESCAPED_AT_ENDS = frozenset(". ")

NOTHING = "%"
"""Stands for an empty part, as in `a//b`: an escape has two digits, so no other part is that."""

MOST_BYTES = 180
"""Longer parts are cut; most systems take 255 bytes, suffix included."""

MOST_BYTES_IN_ALL, MOST_PARTS = 600, 32
"""More of an item gives way to a digest; some systems take 1024 bytes, folder included."""


def file_stem(item: str) -> PurePosixPath:
    """Return the relative path, without suffix, of the files of an item: `walk/007` -> walk/007.

    `/` divides folders. Other characters that a name cannot have are written %XX, as in URLs; the
    end of a part beyond 180 bytes gives way to its digest, and the last parts of an item beyond 600
    bytes or 32 parts to the digest of the item. No path leads out of its folder.
    """
    stem = PurePosixPath(*map(_part, item.split("/")))
    if len(bytes(stem)) <= MOST_BYTES_IN_ALL and len(stem.parts) <= MOST_PARTS:
        return stem
    folders = PurePosixPath(*stem.parts[: MOST_PARTS - 1])
    while len(bytes(folders)) > MOST_BYTES_IN_ALL - MOST_BYTES:
        folders = folders.parent
    # No other part begins so: two digits follow `%`, or nothing.
    return folders / f"%-{_digest(item)}"


def _part(text: str) -> str:
    last = len(text) - 1
    name = "".join(
        _escaped(letter) if place in (0, last) and letter in ESCAPED_AT_ENDS else _safe(letter)
        for place, letter in enumerate(text)
    )
    if len(name.encode()) <= MOST_BYTES:
        return name or NOTHING
    head = name.encode()[:MOST_BYTES].decode(errors="ignore")
    return f"{head}%-{_digest(text)}"


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def _safe(letter: str) -> str:
    return letter if letter.isprintable() and letter not in ESCAPED else _escaped(letter)


def _escaped(letter: str) -> str:
    """Return %XX, also for characters that `quote` leaves alone."""
    return quote(letter, safe="") if letter != "." else "%2E"
