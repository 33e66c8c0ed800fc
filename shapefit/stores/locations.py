"""What a text names: a file of this machine, or an object of a store."""

from __future__ import annotations

from collections.abc import Generator
from pathlib import Path
from typing import Self
from urllib.parse import unquote, urlsplit

from shapefit.stores.copies import local_copy
from shapefit.stores.listing import objects_in
from shapefit.stores.states import find_state
from shapefit.stores.urls import UrlPath, is_url


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
