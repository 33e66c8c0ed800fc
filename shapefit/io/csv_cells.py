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
from shapefit.io.inputs import read_text_blocks, source_name
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

WORD_BYTES = 8
"""Texts go to the core as words of this size."""


def open_table(path: Path, *, live: bool = False) -> tuple[list[str], Iterator[Cells]]:
    """Open a table, and return its columns, and blocks of its rows as an iterator.

    It is a file, a pipe or standard input; empty rows are passed over. Where the header
    has spaces around its names, they are taken from the cells, too. With `live` a block
    of standard input has the rows that have come. Raises InputError for text that is no
    CSV in UTF-8 with commas, and for rows of another width.
    """
    name = source_name(path)
    texts = _read_texts(path, live)
    at_once = 1 if live else ROWS
    _, text = next(texts)
    first, _, rest = text.partition("\n")
    _, header = next(read_rows([first], 1, name), (1, [""]))
    columns = [column.strip() for column in header]

    spaced = columns != header
    rows = chain([(2, rest)], texts)
    return columns, _divided(rows, columns, name, at_once, spaced=spaced)


class Cells:
    """The cells of some rows of a table, by column."""

    def __init__(self, lines: Integers, columns: Sequence[str]) -> None:
        """Take the lines (n,) of the file in which rows begin, and the columns."""
        self.lines = lines
        self.columns = columns
        self._texts: dict[str, tuple[Integers, Sequence[str]]] = {}

    def cell(self, column: str, row: int) -> str:
        """Return one cell."""
        raise NotImplementedError

    def listed(self, column: str) -> list[str]:
        """Return the cells (n,) of a column."""
        return [self.cell(column, row) for row in range(len(self.lines))]

    def part(self, rows: slice) -> ListedCells:
        """Return the cells of some rows."""
        numbers = range(len(self.lines))[rows]
        columns = {
            column: [self.cell(column, row) for row in numbers]
            for column in self.columns
        }
        return ListedCells(self.lines[rows], columns)

    def numbers(self, column: str) -> tuple[Floats, Flags]:
        """Return the numbers (n,) of a column, and which of its cells are none.

        As `read_numbers` does.
        """
        raise NotImplementedError

    def texts(self, column: str) -> tuple[Integers, Sequence[str]]:
        """Return the number of the text of each cell (n,), and the texts.

        They are numbered as they come, from 0; once, as several ask for them.
        """
        if column not in self._texts:
            self._texts[column] = self._number_texts(column)
        return self._texts[column]

    def _number_texts(self, column: str) -> tuple[Integers, Sequence[str]]:
        """Return what `texts` does."""
        raise NotImplementedError


class ListedCells(Cells):
    """Cells in lists of texts."""

    def __init__(self, lines: Integers, columns: Mapping[str, Sequence[str]]) -> None:
        super().__init__(lines, [*columns])
        self._columns = columns

    def cell(self, column: str, row: int) -> str:
        """Return one cell."""
        return self._columns[column][row]

    def numbers(self, column: str) -> tuple[Floats, Flags]:
        """Return the numbers of a column, see Cells."""
        return read_numbers(self._columns[column])

    def _number_texts(self, column: str) -> tuple[Integers, Sequence[str]]:
        """Return the texts of a column, see Cells."""
        cells = self._columns[column]
        number_of = {text: number for number, text in enumerate(dict.fromkeys(cells))}
        numbers = np.fromiter(map(number_of.__getitem__, cells), np.int64, len(cells))
        return numbers, [*number_of]


class SplitCells(Cells):
    """Cells by their places in a text, which the core reads."""

    def __init__(
        self,
        lines: Integers,
        data: bytes,
        words: NDArray[np.uint64],
        places: Mapping[str, tuple[Integers, Integers]],
    ) -> None:
        """Take the text, also as the core takes it, and where its cells are.

        places: the first letters of the cells of each column, and the ends.
        """
        super().__init__(lines, [*places])
        self._data = data
        self._words = words
        self._places = places

    def cell(self, column: str, row: int) -> str:
        """Return one cell."""
        starts, ends = self._places[column]
        return self._data[starts[row] : ends[row]].decode()

    def numbers(self, column: str) -> tuple[Floats, Flags]:
        """Return the numbers of a column, see Cells."""
        starts, ends = self._places[column]
        numbers = np.full(len(starts), np.nan)
        is_read = np.zeros(len(starts), bool)
        core.read_csv_numbers(
            letters=self._words,
            starts=starts,
            ends=ends,
            numbers=numbers,
            is_read=is_read,
        )
        invalid = np.zeros(len(starts), bool)
        others = np.flatnonzero(~is_read & (starts < ends))
        if len(others):
            cells = [self.cell(column, row) for row in others.tolist()]
            numbers[others], invalid[others] = read_numbers(cells)
        numbers[starts == ends] = np.nan
        return numbers, invalid

    def _number_texts(self, column: str) -> tuple[Integers, Sequence[str]]:
        """Return the texts of a column, see Cells."""
        starts, ends = self._places[column]
        numbers = np.empty(len(starts), np.int64)
        first = np.empty(len(starts), np.int64)
        count = core.number_csv_texts(
            letters=self._words, starts=starts, ends=ends, numbers=numbers, first=first
        )
        rows = first[:count]
        places = zip(starts[rows].tolist(), ends[rows].tolist(), strict=True)
        return numbers, [self._data[start:end].decode() for start, end in places]


def _read_texts(path: Path, live: bool) -> Iterator[tuple[int, str]]:
    """Yield an input in texts of whole lines, each after the number of its first line.

    Raises InputError for a cell without end, and for what is not UTF-8.
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
            line += data.count(b"\n", 0, end)
        elif end:
            try:
                text = data[:end].decode("utf-8-sig" if line == 1 else "utf-8")
            except UnicodeDecodeError as error:
                line += data.count(b"\n", 0, error.start)
                fix = "save it as CSV in UTF-8"
                raise input_error(f"{name}:{line}", "is not UTF-8 text", fix) from error
            yield line, as_composed(text)
            line += data.count(b"\n", 0, end)


def _ends_with_cr(block: bytes) -> bool:
    r"""Whether the first line ends with \r alone, as Excel for the Mac ends lines."""
    first = block.find(b"\r")
    followed = block[first + 1 : first + 2] == b"\n"
    quoted = block.count(b'"', 0, first) % 2 == 1
    return first >= 0 and not followed and not quoted and b"\n" not in block[:first]


def _divided(
    texts: Iterator[tuple[int, str]],
    columns: Sequence[str],
    name: str,
    at_once: int,
    *,
    spaced: bool,
) -> Iterator[Cells]:
    """Yield the cells of texts, block by block; where `spaced` without spaces around.

    From the first quote on, a block has `at_once` rows. Raises InputError for rows that
    do not have a cell for each column, and for wrong quotes.
    """
    width = len(columns)
    for line, text in texts:
        split = None if spaced else split_cells(text, columns, line)
        if split is not None:
            yield split
            continue
        following = (text for _, text in texts) if '"' in text else ()
        rows = read_rows(chain([text], following), line, name)
        while part := [*islice(rows, at_once)]:
            if wrong := [(at, len(row)) for at, row in part if len(row) != width]:
                end = f"cells for {width} columns; write one cell per column"
                raise input_problems([f"{name}:{at}: has {n} {end}" for at, n in wrong])
            lines = np.array([at for at, _ in part])
            listed: list[Sequence[str]] = [*zip(*(row for _, row in part), strict=True)]
            if spaced:
                listed = [[cell.strip() for cell in column] for column in listed]
            yield ListedCells(lines, dict(zip(columns, listed, strict=True)))


def split_cells(text: str, columns: Sequence[str], line: int) -> SplitCells | None:
    """Return the cells of lines that have an unquoted one a column, None for others.

    `line` is the number of the first. `read_rows` takes every text, and finds the same
    cells.
    """
    text = text.replace("\r\n", "\n") if "\r" in text else text
    if '"' in text or "\r" in text:
        return None
    data = text.removesuffix("\n").encode() + b"\n"
    count = data.count(b"\n")
    words = _as_words(data)
    starts, ends = np.empty((2, len(columns), count), np.int64)
    # Where the first cell is empty, the whole row may be.
    if core.split_csv_lines(letters=words, starts=starts, ends=ends) < count:
        return None
    places = dict(zip(columns, zip(starts, ends, strict=True), strict=True))
    return SplitCells(np.arange(line, line + count), data, words, places)


def _as_words(data: bytes) -> NDArray[np.uint64]:
    """Return a text as the core takes it: 8 letters a word, spaces after the end."""
    size = -(-len(data) // WORD_BYTES) * WORD_BYTES
    return np.frombuffer(data.ljust(size), np.uint64)


def read_rows(
    texts: Iterable[str], line: int, name: str
) -> Iterator[tuple[int, list[str]]]:
    """Yield the line number and cells of each row that is not empty.

    The texts begin with `line`. Raises InputError for wrong quotes.
    """
    lines = chain.from_iterable(StringIO(text, newline="") for text in texts)
    reader = csv.reader(lines, strict=True)
    start = line
    try:
        for row in reader:
            if any(row):
                yield line, row
            line = start + reader.line_num
    except csv.Error as error:
        raise input_error(f"{name}:{line}", f"a bad cell ({error})", QUOTES) from error


def read_numbers(cells: Sequence[str]) -> tuple[Floats, Flags]:
    """Return the numbers (n,) that cells hold, and which cells are no number at all.

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
