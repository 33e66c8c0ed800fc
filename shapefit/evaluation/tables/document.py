"""A report as a list of blocks, which become Markdown or HTML."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Protocol


def markdown_table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a table whose columns line up; those after the first stand to the right."""
    cells = [[cell.replace("|", "\\|") for cell in row] for row in (header, *rows)]
    widths = [max(3, *map(len, column)) for column in zip(*cells, strict=True)]
    rule = ["-" * widths[0], *("-" * (width - 1) + ":" for width in widths[1:])]
    lines = [
        [row[0].ljust(widths[0]), *(c.rjust(w) for c, w in zip(row[1:], widths[1:], strict=True))]
        for row in cells
    ]
    return "\n".join(f"| {' | '.join(line)} |" for line in (lines[0], rule, *lines[1:]))


ABSENT = "–"
"""Cell of a number that does not exist."""

HOW_TO_READ_PAIRS = (
    "Each cell is mean / median over the images; of several sequences, the mean of the sequences' "
    "means and of their medians. Normalised errors are shares of the spread of the true shape; "
    "those in boxes, of the diagonal of the box around the landmarks."
)


class HasMeanAndMedian(Protocol):
    """Errors summed up."""

    @property
    def mean(self) -> float:
        """The mean, nan where there is none."""

    @property
    def median(self) -> float:
        """The median, nan where there is none."""


def number(value: float | None, decimals: int) -> str:
    """Write a number, or that there is none."""
    return ABSENT if value is None or math.isnan(value) else f"{value:.{decimals}f}"


def percent(share: float, decimals: int) -> str:
    """Say 100 % only where it is all of them: digits are cut off, not rounded up."""
    unit = 10**decimals
    return f"{math.floor(100 * unit * share + 1e-9) / unit:.{decimals}f} %"


def decimals_of(values: Iterable[float]) -> int:
    """Digits after the point: three as in the paper, one from 10 on, more for tiny numbers."""
    largest = max((value for value in values if not math.isnan(value)), default=0.0)
    if largest >= 10:
        return 1
    return max(3, 2 - math.floor(math.log10(largest))) if largest > 0 else 3


def pairs(sums: Sequence[HasMeanAndMedian]) -> list[str]:
    """Write *mean / median* of each, all with as many decimals."""
    decimals = decimals_of(value for s in sums for value in (s.mean, s.median))
    return [f"{number(s.mean, decimals)} / {number(s.median, decimals)}" for s in sums]


TAG = re.compile(r"<(?=[a-zA-Z/!?])")
"""What begins HTML in Markdown."""


class Italic(str):
    """A cell that is quoted, not computed here."""

    __slots__ = ()


@dataclass(frozen=True)
class Title:
    """The heading of the whole report."""

    text: str


@dataclass(frozen=True)
class Section:
    """The heading of a section."""

    text: str


@dataclass(frozen=True)
class Table:
    """Rows of cells under a header; the first column names what the row is about."""

    header: Sequence[str]
    rows: Sequence[Sequence[str]]


@dataclass(frozen=True)
class Listing:
    """Lines, one below the other."""

    lines: Sequence[str]


@dataclass(frozen=True)
class Picture:
    """An image file beside the report."""

    file: str
    text: str


Block = str | Title | Section | Table | Listing | Picture
"""A text is a paragraph."""


def as_markdown(blocks: Iterable[Block]) -> str:
    """Return the blocks as a Markdown page, in which no name is HTML."""
    return "\n\n".join(TAG.sub("&lt;", _markdown(block)) for block in blocks) + "\n"


def _markdown(block: Block) -> str:
    match block:
        case Title(text):
            return f"# {text}"
        case Section(text):
            return f"## {text}"
        case Table(header, rows):
            marked = [[_cell(cell) for cell in row] for row in (header, *rows)]
            return markdown_table(marked[0], marked[1:])
        case Listing(lines):
            return "\n".join(f"- {line}" for line in lines)
        case Picture(file, text):
            return f"![{text}]({file})"
        case text:
            return text


def _cell(cell: str) -> str:
    return f"*{cell}*" if isinstance(cell, Italic) else cell
