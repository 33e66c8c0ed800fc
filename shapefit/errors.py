"""The one error a user can cause, and the texts that messages are made of."""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from os import PathLike
from pathlib import Path
from typing import Any


class InputError(Exception):
    """A file, config or argument is wrong; the command ends with exit code 2.

    `problems` holds one line a problem, with the place, the fault and the fix.
    """

    def __init__(self, problems: str | Iterable[str]) -> None:
        self.problems: tuple[str, ...] = (
            (problems,) if isinstance(problems, str) else tuple(problems)
        )
        super().__init__("\n".join(self.problems))


def input_error(place: str | PathLike[str], fault: str, fix: str) -> InputError:
    """Build the one-line error `place: fault; fix`.

    `place` is a file, `file:line`, `file:line:column` or `file:/dataset`.
    """
    return InputError(f"{place}: {fault}; {fix}")


def parse_json(text: object) -> dict[str, Any]:
    """Parse a JSON object, nested 1,000 deep at most; ValueError for any other text."""
    import orjson

    value = orjson.loads(str(text))
    if not isinstance(value, dict):
        raise ValueError("is no JSON object")
    return value


def path_text(path: str | PathLike[str]) -> str:
    r"""Return a path as text that any file can hold: bytes that are not UTF-8 as
    \xe9.
    """
    return os.fsencode(str(path)).decode("utf-8", "backslashreplace")


def as_typed(path: str | PathLike[str]) -> str:
    """Return a path as it is typed in a shell: relative if in the working folder."""
    import shlex

    whole, here = Path(path), Path.cwd()
    text = str(whole.relative_to(here) if whole.is_relative_to(here) else whole)
    return shlex.quote(f"./{text}" if text.startswith("-") else text)


def printable(text: object) -> str:
    """Return a text on one line, with escapes for what a terminal cannot show.

    Names come from files and folders: they may hold colours, line ends, and bytes of no
    encoding.
    """
    plain = text if isinstance(text, str) else str(text)
    return "".join(
        letter if letter.isprintable() else _escape(letter) for letter in plain
    )


def counted(number: int, noun: str) -> str:
    """Return a number with its noun, as `1 atom` or `2 atoms`; the plural ends in s."""
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"


def abbreviate(names: Sequence[str], max_count: int = 5) -> str:
    """Return `a, b, c and 4 more`: the first names, by default five, and a count."""
    more = len(names) - max_count
    return ", ".join(names[:max_count]) + (f" and {more} more" if more > 0 else "")


def _escape(letter: str) -> str:
    """Return the escape sequence of Python for a letter that is not printable."""
    if (
        "\udc80" <= letter <= "\udcff"
    ):  # a byte that is not UTF-8, as Python names files
        return f"\\x{ord(letter) - 0xDC00:02x}"
    return letter.encode("unicode_escape").decode()


def listed(names: Iterable[str], conjunction: str = "or") -> str:
    """Return names as a sentence lists them: a, b or c."""
    *others, last = names
    return f"{', '.join(others)} {conjunction} {last}" if others else last
