"""Read CSV text into columns of cells, with the line of every row at hand for messages."""

from __future__ import annotations

import csv
from collections.abc import Iterator, Sequence
from difflib import get_close_matches
from functools import cached_property
from io import BytesIO, StringIO
from pathlib import Path

import polars as pl

from shapefit.errors import InputError, input_error
from shapefit.io.problems import Problems
from shapefit.io.sources import read_text_bytes, source_name

BYTE_ORDER_MARK = "\ufeff"


class CsvText:
    """The rows of a CSV file as text cells; empty rows are dropped.

    `required` columns must be there, `optional` ones may, in any order. Where the header has
    spaces around its names, so have the cells, and they are taken away. Raises InputError for
    text that is not UTF-8, other columns, and rows with too few or too many cells.
    """

    def __init__(self, path: Path, required: Sequence[str], optional: Sequence[str]) -> None:
        self.name = source_name(path)
        self._data = _with_newlines(read_text_bytes(path))
        self._check_encoding()
        header = self._split_header()
        self._spaced = any(column != column.strip() for column in header)
        self.columns = self._check_header([column.strip() for column in header], required, optional)
        self.cells = self._read_cells()

    def line(self, row: int) -> int:
        """Return the line on which a row of the cells begins, counted from 1."""
        return self._lines[row]

    def place(self, row: int) -> str:
        """Name a row in messages: `file:line`."""
        return f"{self.name}:{self.line(row)}"

    @cached_property
    def _lines(self) -> list[int]:
        return [line for line, _ in self._records()]

    def _records(self) -> Iterator[tuple[int, list[str]]]:
        """Read line number and cells of all rows that are not empty, below the header."""
        reader = csv.reader(StringIO(self._data.decode("utf-8"), newline="\n"))
        line = 1
        try:
            for cells in reader:
                if line > 1 and any(cells):
                    yield line, cells
                line = reader.line_num + 1
        except csv.Error as error:
            raise self._bad_line(line, error) from error

    def _bad_line(self, line: int, error: csv.Error) -> InputError:
        if "new-line" in str(error):
            found, fix = "a line ends in CR alone, others in LF", "end all lines in the same way"
        else:
            found, fix = f"a bad cell ({error})", "check the quotes around it"
        return input_error(f"{self.name}:{line}", found, fix)

    def _check_encoding(self) -> None:
        fix = "save it as CSV in UTF-8"
        try:
            self._data.decode("utf-8")
        except UnicodeDecodeError as error:
            line = self._data.count(b"\n", 0, error.start) + 1
            raise input_error(f"{self.name}:{line}", "is not UTF-8 text", fix) from error
        if b"\0" in self._data:
            line = self._data.count(b"\n", 0, self._data.index(b"\0")) + 1
            raise input_error(f"{self.name}:{line}", "is not text (a zero byte)", fix)

    def _split_header(self) -> list[str]:
        try:
            return next(csv.reader([self._first_line]), [])
        except csv.Error as error:
            raise self._bad_line(1, error) from error

    @cached_property
    def _first_line(self) -> str:
        line = BytesIO(self._data).readline().decode("utf-8").removeprefix(BYTE_ORDER_MARK)
        return line.rstrip("\r\n")

    def _check_header(
        self, columns: list[str], required: Sequence[str], optional: Sequence[str]
    ) -> list[str]:
        wanted = ",".join(required) + "".join(f"[,{column}]" for column in optional)
        known = {*required, *optional}
        place = f"{self.name}:1"
        if not known & set(columns):
            fix = f"write the header {wanted}, with commas"
            raise input_error(place, f"the header is '{self._first_line.strip()[:80]}'", fix)
        problems = Problems()
        for column in columns:
            if column not in known:
                near = get_close_matches(column, known, n=1)
                fix = f"did you mean '{near[0]}'?" if near else f"the columns are {wanted}"
                problems.tell(f"{place}: unknown column '{column}'; {fix}")
            elif columns.count(column) > 1:
                fix = "keep one of them"
                problems.tell(f"{place}: the column '{column}' repeats; {fix}")
        for column in required:
            if column not in columns:
                fix = f"the columns are {wanted}"
                problems.tell(f"{place}: there is no column '{column}'; {fix}")
        problems.raise_if_any()
        return columns

    def _read_cells(self) -> pl.DataFrame:
        try:
            cells = pl.read_csv(self._data, infer_schema=False, new_columns=self.columns)
        except pl.exceptions.PolarsError as error:
            self._check_widths()
            reason = str(error).partition("\n")[0]
            fix = "put cells with commas or quotes in double quotes, and double the quotes in them"
            raise input_error(self._quoted(), f"cannot be read as CSV ({reason})", fix) from error
        cells = cells.filter(pl.any_horizontal(pl.all().fill_null("") != ""))
        commas = self._data.count(b",")
        if b'"' in self._data or commas != (len(self.columns) - 1) * (len(cells) + 1):
            self._check_widths()
        return cells.with_columns(pl.all().str.strip_chars()) if self._spaced else cells

    def _quoted(self) -> str:
        """Name the first line with a quote inside a cell: what else could polars refuse?"""
        lines = (line for line, cells in self._records() if any('"' in cell for cell in cells))
        line = next(lines, None)
        return self.name if line is None else f"{self.name}:{line}"

    def _check_widths(self) -> None:
        problems = Problems()
        width = len(self.columns)
        for number, (line, cells) in enumerate(self._records()):
            if len(cells) != width:
                found = f"has {len(cells)} cells for {width} columns"
                fix = "write one cell a column"
                problems.tell(f"{self.name}:{line}: {found}; {fix}", number)
        problems.raise_if_any()


def _with_newlines(data: bytes) -> bytes:
    """Return text whose lines end in CR alone, as on old Macs, with the line ends of today."""
    return data if b"\n" in data else data.replace(b"\r", b"\n")
