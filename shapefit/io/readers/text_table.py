"""Text as rows of numbers: what is wrong with a row or a cell is told with its line."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import islice
from pathlib import Path

import numpy as np
import orjson

from shapefit.arrays import Flags, Floats, Integers
from shapefit.errors import printable
from shapefit.io.checks import input_problems
from shapefit.io.csv_file import read_rows, refuse_zero_bytes
from shapefit.io.inputs import BYTE_ORDER_MARK, read_whole
from shapefit.io.readers.columns import decode
from shapefit.io.tidy_table import read_numbers

EMPTY = {"", "na", "n/a", "#n/a", "none", "null", "-", "nan"}
"""Cells, in small letters, that say that there is no number."""

MISSING_FIX = "write a number, or leave the cell empty where the landmark is missing"

Row = tuple[int, list[str]]
"""A line, and its cells."""


def read_text(path: Path) -> str:
    r"""Return a text with lines that end in \n. Bytes that are not UTF-8 become \xe9."""
    text = read_whole(path).removeprefix(BYTE_ORDER_MARK).decode("utf-8", "backslashreplace")
    return text.replace("\r\n", "\n").replace("\r", "\n")


class Table:
    """The rows of a text table, below its header.

    Rows have a cell for each of `names`, the columns; rows without any content are left out. Cells
    are parted by `delimiter`, None for spaces in any number; with another one than `,` the decimal
    point may be a comma. With `padded` rows may end before their empty cells, or after more of
    them. `hint` ends every message.
    """

    def __init__(self, path: Path, delimiter: str | None = ",", text: str | None = None) -> None:
        """Take the text of a file, by default as it is there."""
        self.path, self.delimiter = path, delimiter
        text = decode(read_whole(path)) if text is None else text
        self.text = text.replace("\r\n", "\n").replace("\r", "\n")
        refuse_zero_bytes(self.text, str(path), 1)
        self.names: tuple[str, ...] = ()
        self.padded, self.hint = False, ""
        self._header = 0

    def skip(self, lines: int, names: Sequence[str]) -> None:
        """Leave out the first lines; the columns of the others have these names in messages."""
        self._header, self.names = lines, tuple(names)

    def first_rows(self, count: int) -> list[Row]:
        """Return the first rows."""
        return [(line, self._split(row)) for line, row in islice(self._rows(), count)]

    def read(
        self,
        numbers: Sequence[int],
        texts: Sequence[int] = (),
        *,
        finite: bool = False,
        empty: bool = True,
    ) -> tuple[Floats, list[list[str]], Integers]:
        """Return columns of numbers (n, ...), NaN for empty cells; of texts; and the lines (n,).

        Raises InputError for rows of another width, and for cells that are no numbers, or not
        `finite` ones, or that have none, unless they may be `empty`.
        """
        rows = list(self._rows())
        lines = np.array([line for line, _ in rows], np.int64)
        values = self._read_plain([row for _, row in rows])
        if values is not None and (empty or not np.isnan(values).any()):
            found = [[self._split(row)[column].strip() for _, row in rows] for column in texts]
            return values[:, numbers], found, lines
        cells = self._columns([self._split(row) for _, row in rows], lines)
        told: list[tuple[int, str]] = []
        values = np.empty((len(rows), len(numbers)))
        for place, column in enumerate(numbers):
            values[:, place], wrong = self._numbers(cells[column])
            wrong |= finite & np.isinf(values[:, place])
            wrong |= (not empty) & np.isnan(values[:, place])
            for row in np.flatnonzero(wrong)[:10].tolist():
                cell = printable(cells[column][row].strip()[:40])
                what = f"{cell!r} is no number (column {printable(self.names[column])})"
                fix = MISSING_FIX if empty else "correct it"
                told.append((row, f"{self.path}:{lines[row]}: {what}; {fix}{self.hint}"))
        if told:
            raise input_problems([line for _, line in sorted(told, key=lambda each: each[0])])
        return values, [[*map(str.strip, cells[column])] for column in texts], lines

    def _rows(self) -> Iterator[tuple[int, str | list[str]]]:
        """Yield the line and the text of each row that has content; of a quoted table its cells."""
        if '"' in self.text and self.delimiter is not None:
            for line, cells in read_rows([self.text], 1, str(self.path), self.delimiter):
                if line > self._header and any(map(str.strip, cells)):
                    yield line, cells
            return
        nothing = f" \t{self.delimiter or ''}"
        for line, text in enumerate(self.text.split("\n")[self._header :], self._header + 1):
            if text.strip(nothing):
                yield line, text if self.delimiter else text.strip()

    def _split(self, row: str | list[str]) -> list[str]:
        return row.split(self.delimiter) if isinstance(row, str) else row

    def _read_plain(self, rows: Sequence[str | list[str]]) -> Floats | None:
        """Return rows of plain numbers alone (n, width), NaN for empty cells; None for others.

        JSON reads them several times as fast as cell by cell.
        """
        plain = [row for row in rows if isinstance(row, str)]
        if not plain or len(plain) < len(rows):
            return None
        delimiter, width = self.delimiter or ("\t" if "\t" in plain[0] else " "), len(self.names)
        if any(row.count(delimiter) != width - 1 for row in plain):
            return None
        text = ",".join(plain).replace(delimiter, ",")
        text = f",{text},".replace(",,", ",null,").replace(",,", ",null,")[1:-1]
        try:
            values = orjson.loads(f"[{text}]")
        except orjson.JSONDecodeError:
            return None
        if len(values) != len(rows) * width or not set(map(type, values)) <= _PLAIN:
            return None
        return np.array(values, np.float64).reshape(len(rows), width)

    def _columns(self, split: Sequence[list[str]], lines: Integers) -> list[tuple[str, ...]]:
        """Return the cells of rows by column."""
        width = len(self.names)
        if self.padded:
            split = [
                cells if any(map(str.strip, cells[width:])) else (cells + [""] * width)[:width]
                for cells in split
            ]
        told = [
            f"{self.path}:{line}: has {len(cells)} cells for {width} columns; "
            "write one cell per column"
            for line, cells in zip(lines.tolist(), split, strict=True)
            if len(cells) != width
        ]
        if told:
            raise input_problems(told)
        return list(zip(*split, strict=True)) or [()] * width

    def _numbers(self, cells: Sequence[str]) -> tuple[Floats, Flags]:
        """Return a column as numbers, and which cells are none."""
        values, strange = read_numbers(cells)
        if strange.any():
            plain = ["" if (cell := each.strip()).lower() in EMPTY else cell for each in cells]
            if self.delimiter != "," and not any("." in cell for cell in plain):
                plain = [cell.replace(",", ".") for cell in plain]
            values, strange = read_numbers(plain)
        return values, strange


_PLAIN = {float, int, type(None)}
