"""What a pipeline reports to its caller while it works."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Failure:
    """An item that could not be done, and why."""

    item: str
    reason: str


@dataclass(frozen=True)
class Outcome:
    """What became of one stretch of the work.

    `done` items of `total` (None where it is not known) were finished by this stretch, `failures`
    of them without a result; `note` is a short state of the work for a progress bar, `written`
    the files that now stand complete.
    """

    done: int = 0
    total: int | None = None
    failures: tuple[Failure, ...] = ()
    warnings: tuple[str, ...] = ()
    note: str = ""
    written: tuple[Path, ...] = ()


def nothing_in(count: int, unit: str) -> tuple[str, ...]:
    """Warn of inputs that hold nothing."""
    return () if count else (f"the input holds no {unit}",)
