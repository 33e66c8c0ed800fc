"""The cells of a table with commas: text to numbers, and to texts that are numbered.

Text is split at commas while it holds no quote; from the first quote on, and for lines
that do not fit, the csv module reads it.
"""

from __future__ import annotations

import csv
from collections.abc import Iterable, Iterator, Mapping, Sequence
from io import StringIO
from itertools import chain, islice
from pathlib import Path

import numpy as np
import orjson
from numpy.typing import NDArray

from shapefit import core
from shapefit.arrays import Flags, Floats, Integers
from shapefit.errors import input_error
from shapefit.io.checks import input_problems
from shapefit.io.inputs import BYTE_ORDER_MARK, read_text_blocks, source_name
from shapefit.records.names import as_composed

ROWS = 1 << 12
"""Rows that are read and written at a time: more leave the processor's cache, and take
longer.
"""

QUOTES = (
    "put cells with commas or quotes in double quotes, and double the quotes in them"
)

MIN_SKIPPED_BYTES = 1 << 15
"""Bytes of empty lines from which they are passed over: a file can be full of them, but
no name is.
"""

LINE_END = ord("\n")

WORD_BYTES = 8
"""Texts go to the core as words of this size."""


def open_table(path: Path, *, live: bool = False) -> tuple[list[str], Iterator[Cells]]:
    """Open a CSV table; return its column names, and an iterator over blocks of rows.

    It is a file, a pipe or standard input; empty rows are passed over. Where the header
    has spaces around its names, they are taken from the cells, too. With `live` a block
    of standard input has the rows that have come. Raises InputError for text that is no
    CSV in UTF-8 with commas, and for rows of another width.
    """
    name = source_name(path)
    texts = _read_texts(path, live)
    max_rows = 1 if live else ROWS
    _, text = next(texts)
    first, _, rest = text.partition(b"\n")
    _, header = next(parse_rows([first.decode()], 1, name), (1, [""]))
    columns = [column.strip() for column in header]

    spaced = columns != header
    rows = chain([(2, rest)], texts)
    return columns, _split_blocks(rows, columns, name, max_rows, spaced=spaced)


class Cells:
    """The cells of some rows of a table, by column."""

    def __init__(self, lines: Integers, columns: Sequence[str]) -> None:
        """Take the line numbers (n,) where rows begin, and the names of columns."""
        self.lines = lines
        self.columns = columns
        self._texts: dict[str, tuple[Integers, Sequence[str]]] = {}

    def cell(self, column: str, row: int) -> str:
        """Return the text of one cell."""
        raise NotImplementedError

    def column_texts(self, column: str) -> list[str]:
        """Return the texts (n,) of all cells of a column."""
        return [self.cell(column, row) for row in range(len(self.lines))]

    def select_rows(self, rows: slice) -> ListedCells:
        """Return the cells of these rows."""
        numbers = range(len(self.lines))[rows]
        columns = {
            column: [self.cell(column, row) for row in numbers]
            for column in self.columns
        }
        return ListedCells(self.lines[rows], columns)

    def numbers(self, column: str) -> tuple[Floats, Flags]:
        """Return the cells of a column as numbers (n,), and a mask of invalid cells.

        As `read_numbers` does.
        """
        raise NotImplementedError

    def unique_texts(self, column: str) -> tuple[Integers, Sequence[str]]:
        """Return i (n,) and the unique texts of a column: cell j is texts[i[j]].

        Texts are in the order in which they first come. They are found once.
        """
        if column not in self._texts:
            self._texts[column] = self._number_texts(column)
        return self._texts[column]

    def _number_texts(self, column: str) -> tuple[Integers, Sequence[str]]:
        """Return indices (n,) and unique texts of a column, see `unique_texts`."""
        raise NotImplementedError


class ListedCells(Cells):
    """Cells as a list of texts for each column."""

    def __init__(self, lines: Integers, columns: Mapping[str, Sequence[str]]) -> None:
        super().__init__(lines, [*columns])
        self._columns = columns

    def cell(self, column: str, row: int) -> str:
        """Return the text of one cell."""
        return self._columns[column][row]

    def numbers(self, column: str) -> tuple[Floats, Flags]:
        """Return the cells of a column as numbers (n,), and a mask of invalid cells."""
        return read_numbers(self._columns[column])

    def _number_texts(self, column: str) -> tuple[Integers, Sequence[str]]:
        """Return indices (n,) and unique texts of a column, see `unique_texts`."""
        cells = self._columns[column]
        number_of = {text: number for number, text in enumerate(dict.fromkeys(cells))}
        numbers = np.fromiter(map(number_of.__getitem__, cells), np.int64, len(cells))
        return numbers, [*number_of]


class SplitCells(Cells):
    """Cells by their offsets in a text, which the C++ core reads."""

    def __init__(
        self,
        lines: Integers,
        columns: Sequence[str],
        data: bytes,
        words: NDArray[np.uint64],
        ends: Integers,
        *,
        spaced: bool,
    ) -> None:
        """Take a text as bytes and as words for the core, and where its cells end.

        ends: (n, columns), offsets in the bytes; each cell begins behind the one
        before. Where `spaced`, spaces around cells do not belong to them.
        """
        super().__init__(lines, columns)
        self._data = data
        self._words = words
        self._ends = ends
        self._spaced = spaced
        self._place = {column: place for place, column in enumerate(columns)}

    def cell(self, column: str, row: int) -> str:
        """Return the text of one cell."""
        ends = self._ends.ravel()
        place = row * len(self.columns) + self._place[column]
        start = ends[place - 1] + 1 if place else 0
        text = self._data[start : ends[place]].decode()
        return text.strip() if self._spaced else text

    def numbers(self, column: str) -> tuple[Floats, Flags]:
        """Return the cells of a column as numbers (n,), and a mask of invalid cells."""
        numbers = np.empty(len(self.lines))
        is_read = np.empty(len(self.lines), bool)
        other_count = core.read_csv_numbers(
            letters=self._words,
            ends=self._ends,
            column=self._place[column],
            spaced=self._spaced,
            numbers=numbers,
            is_read=is_read,
        )
        invalid = np.zeros(len(self.lines), bool)
        if other_count:
            others = np.flatnonzero(~is_read)
            cells = [self.cell(column, row) for row in others.tolist()]
            numbers[others], invalid[others] = read_numbers(cells)
        return numbers, invalid

    def _number_texts(self, column: str) -> tuple[Integers, Sequence[str]]:
        """Return indices (n,) and unique texts of a column, see `unique_texts`."""
        numbers = np.empty(len(self.lines), np.int64)
        unique = np.empty_like(self._words)
        size = core.number_csv_texts(
            letters=self._words,
            ends=self._ends,
            column=self._place[column],
            spaced=self._spaced,
            numbers=numbers,
            unique=unique,
        )
        texts = unique.view(np.uint8)[: size - 1].tobytes()  # without the last line end
        return numbers, texts.decode().split("\n")


def _read_texts(path: Path, live: bool) -> Iterator[tuple[int, bytes]]:
    """Yield blocks of whole lines of an input: number of the first line, and the text.

    That is in UTF-8, and in Unicode's composed form. Raises InputError for a cell
    without end, and for what is not UTF-8.
    """
    name, line, rest = source_name(path), 1, b""
    old_ends = False
    blocks = read_text_blocks(path, live=live)
    for number, block in enumerate(chain(blocks, [b""])):
        old_ends = _ends_with_cr(block) if number == 0 else old_ends
        data = rest + (block.replace(b"\r", b"\n") if old_ends else block)
        end = (
            data.rfind(b"\n") + 1 if block else len(data)
        )  # the last line may have no end
        rest = data[end:]
        if len(rest) > csv.field_size_limit():
            fix = "check the quotes around it, and the ends of lines"
            raise input_error(f"{name}:{line}", "a bad cell (it has no end)", fix)
        if end > MIN_SKIPPED_BYTES and line > 1 and not data[:end].strip():
            line += _count_lines(data[:end])
        elif end:
            whole_lines = data[:end]
            if line == 1:
                whole_lines = whole_lines.removeprefix(BYTE_ORDER_MARK)
            try:
                text = _as_composed_bytes(whole_lines)
            except UnicodeDecodeError as error:
                line += _count_lines(whole_lines[: error.start])
                fix = "save it as CSV in UTF-8"
                raise input_error(f"{name}:{line}", "is not UTF-8 text", fix) from error
            yield line, text
            line += _count_lines(whole_lines)


def _as_composed_bytes(text: bytes) -> bytes:
    """Return a text in UTF-8 in Unicode's composed form, see `as_composed`."""
    return text if text.isascii() else as_composed(text.decode()).encode()


def _count_lines(text: bytes) -> int:
    """Return the number of ends of lines; `bytes.count` takes eight times as long."""
    return int(np.count_nonzero(np.frombuffer(text, np.uint8) == LINE_END))


def _ends_with_cr(block: bytes) -> bool:
    r"""Whether the first line ends with \r alone, as Excel for the Mac ends lines."""
    first = block.find(b"\r")
    followed = block[first + 1 : first + 2] == b"\n"
    quoted = block.count(b'"', 0, first) % 2 == 1
    return first >= 0 and not followed and not quoted and b"\n" not in block[:first]


def _split_blocks(
    texts: Iterator[tuple[int, bytes]],
    columns: Sequence[str],
    name: str,
    max_rows: int,
    *,
    spaced: bool,
) -> Iterator[Cells]:
    """Split texts of whole lines, each after its line number, into blocks of cells.

    Where `spaced`, spaces around cells are removed. From the first quote on, a block
    has `max_rows` rows. Raises InputError for rows that do not have a cell for each
    column, and for wrong quotes.
    """
    width = len(columns)
    for line, text in texts:
        split = split_cells(text, columns, line, spaced=spaced)
        if split is not None:
            yield split
            continue
        following = (text for _, text in texts) if b'"' in text else ()
        decoded = (part.decode() for part in chain([text], following))
        rows = parse_rows(decoded, line, name)
        while part := [*islice(rows, max_rows)]:
            if wrong := [(at, len(row)) for at, row in part if len(row) != width]:
                end = f"cells for {width} columns; write one cell per column"
                raise input_problems([f"{name}:{at}: has {n} {end}" for at, n in wrong])
            lines = np.array([at for at, _ in part])
            listed: list[Sequence[str]] = [*zip(*(row for _, row in part), strict=True)]
            if spaced:
                listed = [[cell.strip() for cell in column] for column in listed]
            yield ListedCells(lines, dict(zip(columns, listed, strict=True)))


def split_cells(
    text: bytes, columns: Sequence[str], first_line: int, *, spaced: bool = False
) -> SplitCells | None:
    """Split lines at commas; None if one has quotes, or not a cell for each column.

    Where `spaced`, spaces around cells are removed; None for texts beyond ASCII, which
    has other spaces. `parse_rows` takes every text, and finds the same cells.
    """
    if b"\r" in text:
        text = text.replace(b"\r\n", b"\n")
    if b'"' in text or b"\r" in text:
        return None
    if not text.endswith(b"\n"):
        text += b"\n"
    if spaced and not text.isascii():
        return None
    count = _count_lines(text)
    words = _as_words(text)
    ends = np.empty((count, len(columns)), np.int64)
    # Where the first cell is empty, the whole row may be.
    if core.split_csv_lines(letters=words, ends=ends) < count:
        return None
    lines = np.arange(first_line, first_line + count)
    return SplitCells(lines, columns, text, words, ends, spaced=spaced)


def _as_words(data: bytes) -> NDArray[np.uint64]:
    """Return bytes of text as 64-bit words for the core, filled up by spaces."""
    size = -(-len(data) // WORD_BYTES) * WORD_BYTES
    return np.frombuffer(data.ljust(size), np.uint64)


def parse_rows(
    texts: Iterable[str], first_line: int, name: str
) -> Iterator[tuple[int, list[str]]]:
    """Parse CSV; yield the line number and cells of each row that is not empty.

    Raises InputError for wrong quotes in the file called `name`.
    """
    lines = chain.from_iterable(StringIO(text, newline="") for text in texts)
    reader = csv.reader(lines, strict=True)
    line = first_line
    try:
        for row in reader:
            if any(row):
                yield line, row
            line = first_line + reader.line_num
    except csv.Error as error:
        raise input_error(f"{name}:{line}", f"a bad cell ({error})", QUOTES) from error


def read_numbers(cells: Sequence[str]) -> tuple[Floats, Flags]:
    """Convert cells to numbers (n,); return them and a mask of cells that are invalid.

    They are decimal, inf or nan. Spaces around them do not count; an empty cell, and
    what is no number, is NaN.
    """
    invalid = np.zeros(len(cells), bool)
    filled = [cell or "null" for cell in cells] if "" in cells else cells
    try:
        values = orjson.loads(f"[{','.join(filled)}]")  # four times as fast as float()
    except orjson.JSONDecodeError:
        values = []
    if len(values) == len(cells):
        kinds = set(map(type, values))
        if kinds <= {float, int}:
            return np.fromiter(values, np.float64, len(values)), invalid
        if kinds <= {float, int, type(None)} and values.count(None) == cells.count(""):
            return np.array(values, np.float64), invalid
    numbers = np.full(len(cells), np.nan)
    for row, cell in enumerate(map(str.strip, cells)):
        try:
            invalid[row] = (
                "_" in cell or not cell.isascii()
            )  # which float() alone would take
            numbers[row] = np.nan if invalid[row] else float(cell or "nan")
        except ValueError:
            invalid[row] = True
    return numbers, invalid
