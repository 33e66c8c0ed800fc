"""What a pipeline reports to its caller while it works."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

from shapefit.errors import InputError, counted


class Failure(NamedTuple):
    """An item that could not be done, and why."""

    item: str
    reason: str


@dataclass(frozen=True, eq=False, repr=False)
class Counted:
    """A warning about some items, such as `12 images not optimal`, maybe with names."""

    number: int
    noun: str
    text: str
    items: tuple[str, ...] = ()
    is_note: bool = False
    """Whether it is good to know, with nothing wrong."""

    def __add__(self, other: Counted) -> Counted:
        return replace(
            self, number=self.number + other.number, items=self.items + other.items
        )

    def __str__(self) -> str:
        return f"{counted(self.number, self.noun)} {self.text}"


class Note(str):
    """A text among the warnings that is good to know, with nothing wrong."""


class CameraNumbers(NamedTuple):
    """The camera of a fit: focal length and principal point in pixels.

    Both are None under weak perspective, and where each file or image has its own.
    """

    perspective: bool
    focal: float | None = None
    principal_point: tuple[float, float] | None = None


class Numbers(NamedTuple):
    """What a command found, in numbers; None for what it does not say.

    images; how many of them are trusted, and the median of the errors expected of
    these; share_inside_regions, by result, of the true landmarks that are in their 90%
    regions; how many images are optimal to their tolerance or not, and their
    largest_gap.
    """

    images: int | None = None
    trusted: int | None = None
    expected_error_metres: float | None = None
    share_inside_regions: Mapping[str, float | None] | None = None
    optimal: int | None = None
    not_optimal: int | None = None
    largest_gap: float | None = None
    camera: CameraNumbers | None = None


class Result(NamedTuple):
    """The result of one part of the work.

    It has `done` items of `total`, None where that is not known. reasons count the
    items whose result is not to be trusted; unit is what the items are, where that
    depends on the config; note is a short state for a progress bar, and line is shown
    at once. written are the files that now stand complete; digest, that of the contents
    of a result; rows, a summary for people, label and text; numbers, the same for
    programs; data gives what the note says in values of JSON.
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
    digest: str = ""
    numbers: Numbers | None = None
    data: Callable[[], object] | None = None


def unreadable_file(path: Path, error: InputError) -> Failure:
    """Return the Failure of a file that cannot be read, its reason without the name."""
    problems = (problem.removeprefix(f"{path}:").strip() for problem in error.problems)
    return Failure(str(path), "; ".join(problems))


def merge_warnings(
    total: dict[str, str | Counted],
    warnings: Iterable[str | Counted],
    max_warnings: int = sys.maxsize,
) -> int:
    """Add warnings to those of a run, equal texts as one; return how many are left out.

    They are left out beyond `max_warnings` different ones.
    """
    omitted = 0
    for warning in warnings:
        text = warning if isinstance(warning, str) else f"{warning.noun} {warning.text}"
        before = total.get(text)
        if before is None and len(total) >= max_warnings:
            omitted += 1
        elif isinstance(before, Counted) and isinstance(warning, Counted):
            total[text] = before + warning
        else:
            total[text] = warning
    return omitted


def warn_of_empty(count: int, unit: str) -> tuple[str, ...]:
    """Return a warning that the input has no `unit`, such as images, if count is 0."""
    return () if count else (f"the input holds no {unit}",)
