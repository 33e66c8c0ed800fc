"""Files of text, read whole: JSON, and tables of cells."""

from __future__ import annotations

import csv
import json
import math
import os
import re
from collections.abc import Iterator, Sequence
from contextlib import suppress
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
import orjson

from shapefit.arrays import Floats
from shapefit.errors import input_error, printable
from shapefit.io.csv_cells import read_numbers
from shapefit.io.inputs import (
    BYTE_ORDER_MARK,
    UTF16_MARKS,
    check_fits,
    read_whole,
)
from shapefit.io.readers.poses import library_reads, require
from shapefit.records.names import as_composed

MANY_LINES = 1 << 22
"""From which on the lines of a text hold a letter each in the mean."""

BLANK = ' \t,;"\n'
"""Letters of a line that holds nothing."""

LINE_BYTES = 60
"""Memory that a line takes beside its letters."""

_NOT_JSON = re.compile(rb"\b(?:NaN|-?Infinity)\b")


def read_json(path: Path, *, keep: bool = False) -> object:
    """Parse a JSON file; InputError, naming the line, where it is none.

    To `keep` the content for the next call takes 0.7 of the time in all. NaN and
    Infinity, which Python writes, are read, too.
    """
    state = os.stat(path)
    content = _parse_json(path, state.st_mtime_ns, state.st_size)
    if not keep:
        _parse_json.cache_clear()
    return content


@lru_cache(maxsize=1)
def _parse_json(path: Path, _mtime_ns: int, _size: int) -> object:
    """Parse a JSON file; cached while its modification time and size stay."""
    data = read_whole(path).removeprefix(BYTE_ORDER_MARK)
    if not data.strip():
        raise input_error(path, "is empty", "make or copy it again, or take it away")
    try:
        return orjson.loads(data)
    except orjson.JSONDecodeError as error:
        with suppress(ValueError, RecursionError):
            if _NOT_JSON.search(data):
                return json.loads(data)
        problem = f"is not whole JSON (from letter {error.colno} of the line on)"
        raise input_error(
            f"{path}:{error.lineno}", problem, "make or copy it again"
        ) from error


def decode(data: bytes) -> str:
    """Decode UTF-8, UTF-16 with a mark, or else Latin-1, to composed Unicode (NFC)."""
    if data.startswith(UTF16_MARKS):
        text = data.decode("utf-16", "replace")
    else:
        try:
            text = data.decode("utf-8-sig")
        except UnicodeDecodeError:
            text = data.decode("latin-1")
    return as_composed(text)


def read_text(path: Path) -> str:
    r"""Read a text file, decoded, with lines that end in \n.

    Raises InputError for a zero byte, and for more lines than memory holds, or any text
    has.
    """
    text = decode(read_whole(path)).replace("\r\n", "\n").replace("\r", "\n")
    lines = text.count("\n")
    if lines > MANY_LINES and len(text) - sum(map(text.count, BLANK)) < lines:
        fault = f"has {lines:,} lines, and most of them are empty"
        raise input_error(path, fault, "take the empty lines out")
    check_fits(str(path), LINE_BYTES * lines)
    if "\0" in text:
        line = 1 + text.count("\n", 0, text.index("\0"))
        raise input_error(
            f"{path}:{line}", "is not text (a zero byte)", "save it as CSV in UTF-8"
        )
    return text


def parse_floats(words: Sequence[str], count: int | None = None) -> list[float]:
    """Convert words to finite numbers; FormatError for others, or another `count`."""
    require(len(words) == (count or len(words)), f"{len(words)} numbers, not {count}")
    values: list[float] = read_numbers(words)[0].tolist()
    wrong = [
        word
        for word, value in zip(words, values, strict=True)
        if not math.isfinite(value)
    ]
    require(not wrong, f"{wrong[0][:40] if wrong else ''!r} is no number")
    return values


EMPTY = {"", "na", "n/a", "#n/a", "none", "null", "-", "nan"}
"""Cells, in small letters, without a number."""

YES = {"true", "t", "yes", "y", "1"}
NO = {"false", "f", "no", "n", "0"}
"""Cells, in small letters, that say yes or no."""

INSIDE = "\x1f"
"""Stands for the delimiter in a cell that has quotes around it."""


class Table(NamedTuple):
    """A table as rows of text (n,), not yet split into cells, and their line numbers
    (n,) in the file.
    """

    path: Path
    names: Sequence[str]
    rows: Sequence[str]
    lines: Sequence[int]
    delimiter: str

    def texts(self, *columns: int) -> list[list[str]]:
        """Return the cells of each of these columns, without spaces around them."""
        last = max(columns, default=0) + 1
        cells = [row.split(self.delimiter, last) for row in self.rows]
        texts = [[row[column].strip() for row in cells] for column in columns]
        if any(INSIDE in row for row in self.rows):
            texts = [
                [cell.replace(INSIDE, self.delimiter) for cell in column]
                for column in texts
            ]
        return texts

    def flags(self, columns: Sequence[int]) -> Floats:
        """Return columns (n, c) of yes and no as 1 and 0, or of numbers; NaN for empty.

        Raises InputError for other cells.
        """
        values = np.empty((len(self.rows), len(columns)))
        for number, column in enumerate(columns):
            cells = [cell.lower() for cell in self.texts(column)[0]]
            if {*cells} <= YES | NO | EMPTY:
                stated = {**dict.fromkeys(YES, 1.0), **dict.fromkeys(NO, 0.0)}
                values[:, number] = [stated.get(cell, np.nan) for cell in cells]
            else:
                values[:, number] = self.numbers([column], finite=True)[:, 0]
        return values

    def numbers(self, columns: Sequence[int], *, finite: bool = False) -> Floats:
        """Return these columns as numbers (n, c), NaN for empty cells.

        Raises InputError for cells that are no numbers, or, where all must be `finite`,
        infinite.
        """
        if (plain := self._plain_numbers(columns)) is not None:
            return plain
        values = np.empty((len(self.rows), len(columns)))
        for number, cells in enumerate(self.texts(*columns)):
            filled = ["" if cell.lower() in EMPTY else cell for cell in cells]
            if self.delimiter != "," and not any("." in cell for cell in filled):
                filled = [cell.replace(",", ".") for cell in filled]
            values[:, number], wrong = read_numbers(filled)
            wrong |= finite & np.isinf(values[:, number])
            for row in np.flatnonzero(wrong)[:1].tolist():
                name = printable(self.names[columns[number]])
                problem = f"{printable(cells[row][:40])!r} is no number (column {name})"
                fix = (
                    "write a number, or leave the cell empty where the landmark is"
                    " missing"
                )
                raise input_error(f"{self.path}:{self.lines[row]}", problem, fix)
        return values

    def _plain_numbers(self, columns: Sequence[int]) -> Floats | None:
        """Return columns as numbers (n, c) if all cells are plain or empty, else None.

        JSON reads 21 MB of DeepLabCut's CSV in half the time that NumPy takes.
        """
        text = f",{','.join(self.rows).replace(self.delimiter, ',')},"
        text = text.replace(",,", ",null,").replace(",,", ",null,")[1:-1]
        try:
            values = orjson.loads(f"[{text}]")
        except orjson.JSONDecodeError:
            return None
        whole = self.rows and len(values) == len(self.rows) * len(self.names)
        if not whole or not {*map(type, values)} <= {float, int, type(None)}:
            return None
        return np.array(values, np.float64).reshape(len(self.rows), -1)[:, columns]


def read_table(
    path: Path,
    text: str,
    names: Sequence[str],
    delimiter: str = ",",
    *,
    after: int,
    padded: bool = False,
) -> Table:
    """Split a text into rows of a table; empty lines and the first `after` are skipped.

    names: those of the columns. Cells in quotes may hold the delimiter. `padded` rows
    may have other numbers of empty cells at their end. Raises InputError for rows of
    other widths.
    """
    blank = f" \t{delimiter}"
    rows: list[str] = []
    numbers: list[int] = []
    for line, quoted in _filled_lines(text, f'{blank}"'):
        if line <= after:
            continue
        row = quoted.replace('"', "")
        count = row.count(delimiter) + 1
        if count > len(names) and '"' in quoted:
            with library_reads(f"line {line} has a cell without an end"):
                cells = next(csv.reader([quoted], delimiter=delimiter), [])
            row = delimiter.join(cell.replace(delimiter, INSIDE) for cell in cells)
            count = len(cells)
        if padded and delimiter in row and count != len(names):
            row = row.rstrip(blank)
            row += delimiter * (len(names) - 1 - row.count(delimiter))
            count = row.count(delimiter) + 1
        if count != len(names):
            problem = f"has {count} cells, not {len(names)}"
            raise input_error(f"{path}:{line}", problem, "write one cell per column")
        rows.append(row)
        numbers.append(line)
    return Table(path, names, rows, numbers, delimiter)


def _filled_lines(text: str, blank: str) -> Iterator[tuple[int, str]]:
    """Yield (line number, line) of each line with a character other than `blank` ones.

    The others, of which a small packed file can hold millions, take no memory.
    """
    letters = re.escape(blank)
    number, end = 1, 0
    for match in re.finditer(rf"^[{letters}]*[^\n{letters}].*", text, re.MULTILINE):
        number += text.count("\n", end, match.start())
        end = match.start()
        yield number, match[0]
