"""URLs of object stores (`s3://bucket/key`) as paths."""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import TYPE_CHECKING, Self

_URL = re.compile(r"([A-Za-z][A-Za-z0-9+.-]+)://")  # not C://, which is a drive of Windows
_USER = re.compile(r"^[^/@]*:[^/@]*@")

if TYPE_CHECKING:
    _Path = Path
else:  # Python 3.11 knows the rules of the system in a subclass only
    _Path = type(Path())


class UrlPath(_Path):
    """A URL as a path: `/`, `parent`, `name` and `suffix` are those of paths, `str` is the URL.

    So all that takes paths takes URLs, and messages show them.
    """

    def __str__(self) -> str:
        """Return the URL, without user and password."""
        scheme, *rest = self.parts
        return f"{scheme}//{_USER.sub('***@', '/'.join(rest))}"

    @property
    def scheme(self) -> str:
        """What stands before `://`."""
        return self.parts[0].removesuffix(":")

    @property
    def url(self) -> str:
        """The URL as it was given, for the store; never for messages."""
        scheme, *rest = self.parts
        return f"{scheme}//{'/'.join(rest)}"

    def resolve(self, strict: bool = False) -> Self:
        """Return the URL, which is complete."""
        return self

    def as_uri(self) -> str:
        """Return the URL."""
        return str(self)

    def is_dir(self) -> bool:
        """Return False: a store has names with `/` in them, and no folders."""
        return False


def real_path(path: Path) -> Path:
    """Return what a path leads to, links followed; a URL as it is."""
    return path if isinstance(path, UrlPath) else Path(os.path.realpath(path))


def is_url(text: str) -> bool:
    """Whether a text begins like a URL."""
    return _URL.match(text) is not None
