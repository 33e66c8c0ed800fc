"""What a pipeline reports to its caller while it works."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from shapefit.errors import InputError, counted


@dataclass(frozen=True)
class Failure:
    """An item that could not be done, and why."""

    item: str
    reason: str


def unread(path: Path, error: InputError) -> Failure:
    """Return the failure of a file that cannot be read, with its reason."""
    here = re.compile(f"{re.escape(str(path))}:(?: |(\\d+: ))")  # `a.csv: found`, `a.csv:2: found`
    problems = (
        here.sub(lambda at: f"line {at[1]}" if at[1] else "", problem) for problem in error.problems
    )
    return Failure(str(path), "; ".join(problems))


@dataclass(frozen=True)
class Counted:
    """A warning about some items of one part of the work: `12 images not optimal`.

    A report adds up those with the same text. `worst` is the item to show as an example, `severity`
    how bad it is: of several parts the most severe one is shown. `items` are the names of all of
    them, where they are known.
    """

    number: int
    noun: str
    text: str
    worst: str = ""
    severity: float = 0.0
    items: tuple[str, ...] = ()

    def __add__(self, other: Counted) -> Counted:
        worse = other if other.severity > self.severity else self
        number, items = self.number + other.number, self.items + other.items
        return replace(worse, number=number, items=items)

    def __str__(self) -> str:
        words = f"{counted(self.number, self.noun)} {self.text}"
        return f"{words}, the worst: {self.worst}" if self.worst else words


class Note(str):
    """Stands among the warnings for what is good to know, and no sign of anything wrong."""


@dataclass(frozen=True)
class Outcome:
    """What became of one part of the work.

    `done` items of `total` (None where it is not known) were finished by this part, `failures`
    of them without a result; `unit` is what the items are, where that depends on the config;
    `note` is a short state of the work for a progress bar, `line` is to be shown at once,
    `reasons` counts the items whose result is not to be trusted, by reason;
    `written` are the files that now stand complete;
    `rows` is a summary for people, label and text; `data` gives what the note says in values of
    JSON, to those who ask.
    """

    done: int = 0
    total: int | None = None
    failures: tuple[Failure, ...] = ()
    warnings: tuple[str | Counted, ...] = ()
    reasons: tuple[Counted, ...] = ()
    unit: str = ""
    note: str = ""
    rows: tuple[tuple[str, str], ...] = ()
    line: str = ""
    written: tuple[Path, ...] = ()
    data: Callable[[], Any] | None = None


def add_up(
    known: dict[str, str | Counted], warnings: Iterable[str | Counted], most: int = sys.maxsize
) -> int:
    """Add warnings to those of a run: a text once, and numbers with the same text as their sum.

    No more than `most` are kept; returns how many were not.
    """
    left = 0
    for warning in warnings:
        key = warning if isinstance(warning, str) else f"{warning.noun} {warning.text}"
        before = known.get(key)
        if before is None and len(known) >= most:
            left += 1
        else:
            both = isinstance(before, Counted) and isinstance(warning, Counted)
            known[key] = before + warning if both else warning  # type: ignore[operator]
    return left


def nothing_in(count: int, unit: str) -> tuple[str, ...]:
    """Warn of inputs that hold nothing."""
    return () if count else (f"the input holds no {unit}",)
