"""A report as a list of blocks, which become Markdown or HTML."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from shapefit.evaluation.tables.markdown import markdown_table

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
