"""Files of text, read whole: tables of cells, and JSON."""

from __future__ import annotations

import csv
import os
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import orjson

from shapefit.arrays import Flags, Floats
from shapefit.errors import input_error, printable
from shapefit.io.inputs import BYTE_ORDER_MARK, read_whole
from shapefit.io.tidy_table import read_numbers

# JSON.

_NOT_JSON = re.compile(rb"\b(?:NaN|-?Infinity)\b")

MAX_CACHED = 1 << 27
"""Bytes of a JSON file whose content is kept from its recognition until it is read."""

_cached: tuple[Any, Any] = (None, None)


def read_json(path: Path, *, keep: bool = False) -> Any:
    """Return the content of a JSON file, and `keep` it for the next call, or give up what was kept.

    NaN and Infinity, which Python writes, are read, too. Raises InputError for a file that is too
    large or damaged, naming the line.
    """
    global _cached
    state = os.stat(path)
    key = (str(path), state.st_mtime_ns, state.st_size)
    content = _cached[1] if _cached[0] == key else _parse_json(path)
    _cached = (key, content) if keep and state.st_size <= MAX_CACHED else (None, None)
    return content


def _parse_json(path: Path) -> Any:
    import json

    data = read_whole(path).removeprefix(BYTE_ORDER_MARK)
    try:
        return orjson.loads(data)
    except orjson.JSONDecodeError as error:
        try:
            if _NOT_JSON.search(data):
                return json.loads(data)
        except (ValueError, RecursionError):
            pass
        problem = f"is not whole JSON ({error.msg})"
        raise input_error(f"{path}:{error.lineno}", problem, "make or copy it again") from error


# Tables.


def decode(data: bytes) -> str:
    """Return text in UTF-8 (with a mark or without), UTF-16 with a mark, or else Latin-1."""
    if data[:2] in (b"\xff\xfe", b"\xfe\xff"):
        return data.decode("utf-16", "replace")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return data.decode("latin-1")


def read_text(path: Path) -> str:
    r"""Return a text with lines that end in \n. Raises InputError for a zero byte."""
    text = decode(read_whole(path)).replace("\r\n", "\n").replace("\r", "\n")
    if "\0" in text:
        line = 1 + text.count("\n", 0, text.index("\0"))
        raise input_error(f"{path}:{line}", "is not text (a zero byte)", "save it as CSV in UTF-8")
    return text


Row = tuple[int, str | list[str]]
"""A line, and its text, or its cells where there are quotes."""


def split_rows(path: Path, text: str, delimiter: str | None = ",") -> list[Row]:
    """Return the rows of a text that have any content; without a delimiter spaces separate cells.

    Raises InputError for the line of a quote that is never closed.
    """
    if '"' not in text or delimiter is None:
        empty = f" \t{delimiter or ''}"
        return [(n, line) for n, line in enumerate(text.split("\n"), 1) if line.strip(empty)]
    rows: list[Row] = []
    reader, line = csv.reader(text.split("\n"), delimiter=delimiter, strict=True), 1
    try:
        for cells in reader:
            if any(map(str.strip, cells)):
                rows.append((line, cells))
            line = reader.line_num + 1
    except csv.Error as error:
        fix = "close every quote, and double the quotes in cells"
        raise input_error(f"{path}:{line}", f"has a bad cell ({error})", fix) from error
    return rows


EMPTY = {"", "na", "n/a", "#n/a", "none", "null", "-", "nan"}
"""Cells, in small letters, that say that there is no number."""


@dataclass
class Table:
    """Rows of cells below a header, in columns of these names.

    With `padded` rows may end before their empty cells, or after more of them.
    """

    path: Path
    rows: list[Row]
    names: Sequence[str] = ()
    delimiter: str | None = ","
    padded: bool = False

    def cells(self, row: int) -> list[str]:
        """Return the cells of a row."""
        text = self.rows[row][1]
        cells = text.split(self.delimiter) if isinstance(text, str) else text
        return [cell.strip() for cell in cells]

    def read(
        self, numbers: Sequence[int], texts: Sequence[int] = (), *, finite: bool = False
    ) -> tuple[Floats, list[list[str]], list[int]]:
        """Return columns of numbers (n, ...), NaN for empty cells; of texts; and the lines (n,).

        Raises InputError for rows of another width, and for cells that are no numbers, or, where
        all must be `finite`, infinite.
        """
        lines, values = [line for line, _ in self.rows], self._read_plain()
        if values is not None and not texts:
            return values[:, numbers], [], lines
        width, rows = len(self.names), [self.cells(row) for row in range(len(lines))]
        if self.padded:
            rows = [row if any(row[width:]) else (row + [""] * width)[:width] for row in rows]
        for line, row in zip(lines, rows, strict=True):
            if len(row) != width:
                problem = f"has {len(row)} cells, not {width}"
                raise input_error(f"{self.path}:{line}", problem, "write one cell per column")
        columns = list(zip(*rows, strict=True)) or [()] * width
        if values is not None:
            return values[:, numbers], [list(columns[column]) for column in texts], lines
        values = np.empty((len(lines), len(numbers)))
        for place, column in enumerate(numbers):
            values[:, place], wrong = self._numbers(columns[column])
            wrong |= finite & np.isinf(values[:, place])
            for row in np.flatnonzero(wrong)[:1].tolist():
                name, cell = printable(self.names[column]), printable(columns[column][row][:40])
                fix = "write a number, or leave the cell empty where the landmark is missing"
                problem = f"{cell!r} is no number (column {name})"
                raise input_error(f"{self.path}:{lines[row]}", problem, fix)
        return values, [list(columns[column]) for column in texts], lines

    def _read_plain(self) -> Floats | None:
        """Return rows of plain numbers alone (n, width), NaN for empty cells; None for others.

        JSON reads them several times as fast as cell by cell.
        """
        rows = [row for _, row in self.rows if isinstance(row, str)]
        if not rows or len(rows) < len(self.rows):
            return None
        rows = rows if self.delimiter else [row.strip() for row in rows]
        delimiter, width = self.delimiter or ("\t" if "\t" in rows[0] else " "), len(self.names)
        if any(row.count(delimiter) != width - 1 for row in rows):
            return None
        text = f",{','.join(rows).replace(delimiter, ',')},"
        text = text.replace(",,", ",null,").replace(",,", ",null,")[1:-1]
        try:
            values = orjson.loads(f"[{text}]")
        except orjson.JSONDecodeError:
            return None
        if len(values) != len(rows) * width or not {*map(type, values)} <= {float, int, type(None)}:
            return None
        return np.array(values, np.float64).reshape(len(rows), width)

    def _numbers(self, cells: Sequence[str]) -> tuple[Floats, Flags]:
        """Return a column as numbers, and which cells are none."""
        values, wrong = read_numbers(cells)
        if wrong.any():
            cells = ["" if cell.lower() in EMPTY else cell for cell in cells]
            if self.delimiter != "," and not any("." in cell for cell in cells):
                cells = [cell.replace(",", ".") for cell in cells]
            values, wrong = read_numbers(cells)
        return values, wrong
