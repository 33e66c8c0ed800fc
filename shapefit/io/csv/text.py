"""Read CSV text a section at a time, which ends where a record ends, into columns of cells.

A section is split at commas where it has no quotes, else read with care; every row has its line.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from difflib import get_close_matches
from io import StringIO
from itertools import chain
from pathlib import Path

import numpy as np
import orjson
from numpy.typing import NDArray

from shapefit.errors import InputError, input_error
from shapefit.io.problems import Problems
from shapefit.io.sources import BYTE_ORDER_MARK, read_text_blocks, source_name

MOST_BYTES = 1 << 20
"""A section grows to this size where no record ends before; a cell cannot be so long."""


@dataclass(frozen=True)
class Section:
    """Whole records of a CSV file: `data` in UTF-8 and as text, and the line they begin on."""

    data: bytes
    text: str
    line: int

    def __bool__(self) -> bool:
        return bool(self.data)

    def without_header(self) -> Section:
        """Return the section without its first line."""
        header, end, _ = self.data.partition(b"\n")
        start = len(header) + len(end)
        return Section(self.data[start:], self.text.partition("\n")[2], self.line + len(end))


def read_sections(path: Path) -> Iterator[Section]:
    """Yield the text of standard input, a pipe or a file; the first section has the header.

    Lines that end in CR alone, as on old Macs, get the line ends of today. Raises InputError as
    `read_text_blocks` does, and for text that is not UTF-8.
    """
    name = source_name(path)
    line, rest, old = 1, b"", False
    for number, block in enumerate(read_text_blocks(path)):
        if number == 0:
            block = block.removeprefix(BYTE_ORDER_MARK)
            old = b"\r" in block and b"\n" not in block
        elif old and b"\n" in block:
            found = "a line ends in CR alone, others in LF"
            raise input_error(f"{name}:1", found, "end all lines in the same way")
        data = rest + (block.replace(b"\r", b"\n") if old else block)
        end = _end_of_records(data)
        rest = data[end:]
        if end:
            yield _decode(data[:end], line, name)
            line += data.count(b"\n", 0, end)
    if rest or line == 1:
        yield _decode(rest, line, name)


def _end_of_records(data: bytes) -> int:
    """Return where the last whole record ends: after a line end with an even count of quotes."""
    end = data.rfind(b"\n") + 1
    open_quote = data.count(b'"', 0, end) % 2 if b'"' in data else 0
    while open_quote and end:
        before = data.rfind(b"\n", 0, end - 1) + 1
        open_quote ^= data.count(b'"', before, end) % 2
        end = before
    if end or len(data) < MOST_BYTES:
        return end
    return data.rfind(b"\n") + 1 or len(data)


def _decode(data: bytes, line: int, name: str) -> Section:
    fix = "save it as CSV in UTF-8"
    try:
        text = data.decode("utf-8")
    except UnicodeDecodeError as error:
        line += data.count(b"\n", 0, error.start)
        raise input_error(f"{name}:{line}", "is not UTF-8 text", fix) from error
    refuse_zero_bytes(text, name, line)
    return Section(data, text, line)


def refuse_zero_bytes(text: str, name: str, line: int) -> None:
    """Raise InputError for the line of a zero byte in a text that begins with this line."""
    if "\0" in text:
        line += text.count("\n", 0, text.index("\0"))
        fix = "save it as CSV in UTF-8"
        raise input_error(f"{name}:{line}", "is not text (a zero byte)", fix)


COMMA, LINE_END = b",\n"

QUOTES = "put cells with commas or quotes in double quotes, and double the quotes in them"


def split_columns(section: Section, width: int) -> list[list[str]] | None:
    """Return the columns of a section in which every line has `width` cells, none of them quoted.

    None where it is not so plain; `read_rows` takes every section, and finds the same cells.
    """
    data, text = section.data, section.text
    if b"\r" in data:
        data, text = data.replace(b"\r\n", b"\n"), text.replace("\r\n", "\n")
    if b'"' in data or b"\r" in data or len(data) > csv.field_size_limit():
        return None
    letters = np.frombuffer(data.removesuffix(b"\n") + b"\n", np.uint8)
    ends, commas = np.flatnonzero(letters == LINE_END), np.flatnonzero(letters == COMMA)
    if len(commas) != len(ends) * (width - 1):
        return None
    between = commas.reshape(len(ends), width - 1)
    if (between[:, -1] > ends).any() or (between[1:, 0] < ends[:-1]).any():
        return None
    cells = text.removesuffix("\n").replace("\n", ",").split(",")
    columns = [cells[column::width] for column in range(width)]
    return None if "" in columns[0] else columns  # there may be an empty row


def read_rows(section: Section, name: str) -> Iterator[tuple[int, list[str]]]:
    """Yield line and cells of each row that is not empty.

    A quote that is never closed swallows the rest of the section as one cell. Raises InputError
    after the last row that can be read, naming the line of the next one.
    """
    quoted = '"' in section.text
    reader = csv.reader(StringIO(section.text, newline="\n"), strict=True)
    line = section.line
    try:
        for row in reader:
            if any(row):
                if quoted:
                    _check_quotes(row, section.text, f"{name}:{line}")
                yield line, row
            line = section.line + reader.line_num
    except csv.Error as error:
        if "unexpected end" not in str(error):
            raise bad_line(f"{name}:{line}", error) from error
        yield line, _last_row(section, line)
        raise input_error(f"{name}:{line}", "a quote is never closed", QUOTES) from error


Columns = Sequence[Sequence[str]]
Lines = NDArray[np.int64]


def read_columns(
    section: Section, width: int, name: str, widths: Problems, *, padded: bool = False
) -> tuple[Columns, Lines]:
    """Return the cells of a section by column, without empty rows, and the line of each row.

    Rows of another width go to `widths`, unless they are `padded` with empty cells.
    """
    columns = split_columns(section, width) if section else None
    if columns is not None:
        return columns, np.arange(section.line, section.line + len(columns[0]))
    rows: list[list[str]] = []
    lines: list[int] = []
    try:
        for line, row in read_rows(section, name):
            row += [""] * (width - len(row)) if padded else []
            if len(row) != width:
                found = f"has {len(row)} cells for {width} columns"
                widths.tell(f"{name}:{line}: {found}; write one cell per column", line)
                continue
            rows.append(row)
            lines.append(line)
    except InputError:
        widths.raise_if_any()
        raise
    return list(zip(*rows, strict=True)) or [()] * width, np.array(lines, np.int64)


def bad_line(place: str, error: csv.Error) -> InputError:
    """Say what the csv module found at a place."""
    if "new-line" in str(error):
        found, fix = "a line ends in CR alone, others in LF", "end all lines in the same way"
    else:
        found, fix = f"a bad cell ({error})", "check the quotes around it"
    return input_error(place, found, fix)


def _last_row(section: Section, line: int) -> list[str]:
    lines = list(StringIO(section.text, newline="\n"))
    return next(csv.reader(lines[line - section.line :]))


def _check_quotes(row: list[str], text: str, place: str) -> None:
    """Refuse an odd number of quotes in a cell that has none around it."""
    for cell in row:
        if cell.count('"') % 2 and '"{}"'.format(cell.replace('"', '""')) not in text:
            raise input_error(place, "cannot be read as CSV (a quote inside a cell)", QUOTES)


@dataclass(frozen=True)
class Block:
    """Some rows of a table: the cells of each column, and the line on which each row begins.

    numbers are columns that are no text.
    """

    cells: dict[str, Sequence[str]]
    lines: Lines
    numbers: Mapping[str, NDArray[np.float64]] = field(default_factory=dict)

    def column(self, name: str) -> Numbers:
        """Return a column as numbers."""
        if name in self.numbers:
            values = self.numbers[name]
            return Numbers(values, np.zeros(len(values), bool))
        return read_numbers(self.cells[name])

    def word(self, name: str, row: int) -> str:
        """Return what stands in a cell."""
        return str(self.numbers[name][row]) if name in self.numbers else self.cells[name][row]


class CsvText:
    """The rows of a CSV file as blocks of text cells; empty rows are dropped.

    `required` columns must be there, `optional` ones may, in any order. Where the header has
    spaces around its names, so have the cells, and they are taken away. Raises InputError for
    text that is not UTF-8 and for other columns.
    """

    def __init__(self, path: Path, required: Sequence[str], optional: Sequence[str]) -> None:
        self.name = source_name(path)
        self._sections = read_sections(path)
        self._first = next(self._sections)
        header = self._split_header()
        self._spaced = any(column != column.strip() for column in header)
        self.columns = self._check_header([column.strip() for column in header], required, optional)

    def blocks(self) -> Iterator[Block]:
        """Give out all rows, once.

        Raises InputError for text that is not UTF-8, for cells that are no CSV and, when
        everything is read, for rows with too few or too many cells.
        """
        widths = Problems()
        for section in chain([self._first.without_header()], self._sections):
            columns, lines = read_columns(section, len(self.columns), self.name, widths)
            if self._spaced:
                columns = [[cell.strip() for cell in column] for column in columns]
            if len(lines):
                yield Block(dict(zip(self.columns, columns, strict=True)), lines)
        widths.raise_if_any()

    def _split_header(self) -> list[str]:
        try:
            return next(csv.reader([self._first_line]), [])
        except csv.Error as error:
            raise bad_line(f"{self.name}:1", error) from error

    @property
    def _first_line(self) -> str:
        return self._first.text.partition("\n")[0].rstrip("\r")

    def _check_header(
        self, columns: list[str], required: Sequence[str], optional: Sequence[str]
    ) -> list[str]:
        wanted = ",".join(required) + "".join(f"[,{column}]" for column in optional)
        known = {*required, *optional}
        place = f"{self.name}:1"
        if not known & set(columns) and len(columns) == 1:
            for letter, name in ((";", "semicolons"), ("\t", "tabs")):
                if letter in columns[0] and not known & set(columns[0].split(letter)):
                    fix = "save it with commas between the cells, and with decimal points"
                    raise input_error(place, f"separates its cells by {name}", fix)
        if "frame_idx" in columns and "item" not in columns:
            fix = "give the .slp file, or export the analysis HDF5 file of SLEAP"
            raise input_error(place, "is one of SLEAP's tables, which are not read", fix)
        if not known & set(columns):
            fix = f"write the header {wanted}, with commas"
            raise input_error(place, f"the header is '{self._first_line.strip()[:80]}'", fix)
        check_columns(columns, required, optional, place)
        return columns

    def place(self, line: int) -> str:
        """Name a line in messages."""
        return f"{self.name}:{line}"


def check_columns(
    columns: Sequence[str], required: Sequence[str], optional: Sequence[str], place: str
) -> None:
    """Raise InputError for columns that are unknown, there twice, or missing."""
    wanted = ",".join(required) + "".join(f"[,{column}]" for column in optional)
    known = {*required, *optional}
    problems = Problems()
    for column in columns:
        if column not in known:
            near = get_close_matches(column, known, n=1)
            fix = f"did you mean '{near[0]}'?" if near else f"the columns are {wanted}"
            problems.tell(f"{place}: unknown column '{column}'; {fix}")
        elif columns.count(column) > 1:
            problems.tell(f"{place}: the column '{column}' repeats; keep one of them")
    for column in required:
        if column not in columns:
            fix = f"the columns are {wanted}"
            problems.tell(f"{place}: there is no column '{column}'; {fix}")
    problems.raise_if_any()


_NUMBERS = {float, int}


@dataclass(frozen=True)
class Numbers:
    """A column as numbers: NaN in cells that are empty or `strange` (no number at all)."""

    values: NDArray[np.float64]
    strange: NDArray[np.bool_]


def read_numbers(cells: Sequence[str]) -> Numbers:
    """Read decimal numbers, inf and nan; spaces around them do not count."""
    none_strange = np.zeros(len(cells), bool)
    filled = [cell or "null" for cell in cells] if "" in cells else cells
    try:
        values = orjson.loads(f"[{','.join(filled)}]")  # four times as fast as float()
    except orjson.JSONDecodeError:
        values = []
    if len(values) == len(cells):
        kinds = set(map(type, values))
        if kinds <= _NUMBERS:
            return Numbers(np.fromiter(values, np.float64, len(values)), none_strange)
        if kinds <= {*_NUMBERS, type(None)} and values.count(None) == cells.count(""):
            return Numbers(np.array(values, np.float64), none_strange)
    return _read_one_by_one(cells)


def _read_one_by_one(cells: Sequence[str]) -> Numbers:
    values = np.full(len(cells), math.nan)
    strange = np.zeros(len(cells), bool)
    for row, cell in enumerate(cells):
        try:
            values[row] = _number(cell.strip())
        except ValueError:
            strange[row] = True
    return Numbers(values, strange)


def _number(cell: str) -> float:
    """Return what a cell says; float() alone would take 1_000 and the digits of all scripts."""
    if not cell:
        return math.nan
    if "_" in cell or not cell.isascii():
        raise ValueError
    return float(cell)
