"""Tidy tables, one row a landmark of an item, from CSV text or columns of Parquet to arrays.

Text is split at commas while it holds no quote; from the first quote on, and for lines that do not
fit, the csv module reads it.
"""

from __future__ import annotations

import csv
import math
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from difflib import get_close_matches
from io import StringIO
from itertools import chain, count
from pathlib import Path
from typing import Any

import numpy as np
import orjson
from numpy.typing import NDArray

from shapefit.arrays import Floats, Integers
from shapefit.errors import InputError, input_error
from shapefit.io.checks import input_problems
from shapefit.io.inputs import BYTE_ORDER_MARK, check_fits, read_text_blocks, source_name
from shapefit.io.records import LandmarkSet, ResultSet, ShapeSet
from shapefit.lifting.verdict import TRUSTED

DEVIATIONS = ("sd_x", "sd_y", "sd_z")
"""Columns of results: standard deviations, which nothing here reads back."""

OPTIONAL = {
    "landmarks": ("confidence", "sequence"),
    "shapes": ("sequence", *DEVIATIONS, "modes", TRUSTED),
    "result": ("sequence", *DEVIATIONS, "modes", TRUSTED),
}
"""Columns that a table may have beside items, landmarks and coordinates."""

FINITE_FIX = "write a finite number"
FIXES = {
    "landmarks": f"{FINITE_FIX}, or leave the cell empty where the landmark is unseen",
    "shapes": FINITE_FIX,
    "gaps": f"{FINITE_FIX}, or leave the cell empty where the landmark is unknown",
    "result": f"{FINITE_FIX}, or leave the cell empty where the item failed",
}

GROWTH = 1.25
"""Room that a growing array makes at once, as a multiple of what it holds."""

ROWS = 1 << 12
"""Rows that the csv module reads at a time."""


@dataclass(frozen=True)
class Block:
    """Some rows of a table: cells of text, columns that are numbers already, lines of the rows."""

    cells: Mapping[str, Sequence[str]]
    lines: NDArray[np.int64]
    numbers: Mapping[str, Floats] = field(default_factory=dict)


def read_shape_table(path: Path, *, gaps: bool = False) -> ShapeSet:
    """Read `item,landmark,x,y,z[,sequence]`, every landmark of every item.

    With `gaps` a landmark that has no row, or an empty or nan coordinate, is unknown: NaN.
    """
    shapes: ShapeSet = read_tidy(path, "shapes", CsvText, gaps=gaps)
    return shapes


def read_landmark_table(path: Path) -> LandmarkSet:
    """Read `item,landmark,x,y[,confidence][,sequence]`; an empty or nan coordinate is unseen."""
    landmarks: LandmarkSet = read_tidy(path, "landmarks", CsvText)
    return landmarks


def read_result_table(path: Path) -> ResultSet:
    """Read `item,landmark,x,y,z[,sequence]`; empty cells stand for items that failed."""
    results: ResultSet = read_tidy(path, "result", CsvText)
    return results


def read_tidy(
    path: Path,
    kind: str,
    open_text: Callable[[Path, Sequence[str], Sequence[str]], Any],
    *,
    gaps: bool = False,
) -> Any:
    """Return the records of a table: items and landmarks in order of appearance.

    open_text takes path, required and optional columns, and gives what has `name`, `columns`,
    `blocks` and a `place` of each line. A landmark that has no row or lacks a coordinate is NaN,
    its confidence 0. Raises InputError for the first wrong cells, by line.
    """
    axes = ("x", "y") if kind == "landmarks" else ("x", "y", "z")
    text = open_text(path, ("item", "landmark", *axes), OPTIONAL[kind])
    table = _Table(text, axes, text.columns, FIXES["gaps" if gaps else kind])
    table.finite = kind == "shapes" and not gaps
    for block in text.blocks():
        table.take(block)
    items, landmarks = table.names("item"), table.names("landmark")
    n, p = len(items), len(landmarks)
    if table.finite:
        _check_complete(text.name, table.lines.cut(n, p), items, landmarks)
    fields: dict[str, Any] = {"landmark_names": landmarks, "items": items}
    if "sequence" in text.columns:
        names = table.names("sequence")
        fields["sequences"] = tuple(names[code] for code in table.sequence.cut(n).tolist())
    points = table.points.cut(n, len(axes), p)
    if kind == "landmarks":
        confidence = table.confidence.cut(n, p) if "confidence" in text.columns else None
        return LandmarkSet(landmarks=points, confidence=confidence, **fields)
    return (ShapeSet if kind == "shapes" else ResultSet)(shapes=points, **fields)


def _check_complete(
    name: str, lines: Integers, items: Sequence[str], landmarks: Sequence[str]
) -> None:
    """Raise InputError where an item lacks a landmark."""
    missing = np.argwhere(lines == 0)
    told = [
        f"{name}: item '{items[row]}' has no landmark '{landmarks[column]}'; "
        "write every landmark of every item"
        for row, column in missing[:10].tolist()
    ]
    if told:
        raise input_problems(told, len(missing))


class _Grid:
    """An array that grows, cheaply along its first axis; new entries hold `fill`."""

    def __init__(self, name: str, axes: int, fill: float, dtype: type[np.generic]) -> None:
        self.values: NDArray[Any] = np.empty((0,) * axes, dtype)
        self._name, self._fill = name, fill

    def reach(self, *shape: int) -> NDArray[Any]:
        """Grow to at least this shape, with room along the first axis to grow again."""
        length, *others = self.values.shape
        if others != list(shape[1:]):
            check_fits(self._name, math.prod(shape) * self.values.itemsize)
            wider = np.full((length, *shape[1:]), self._fill, self.values.dtype)
            wider[tuple(map(slice, self.values.shape))] = self.values
            self.values = wider
        if shape[0] > length:
            self._lengthen(int(GROWTH * shape[0]))
        return self.values

    def cut(self, *shape: int) -> NDArray[Any]:
        """Return the array in this shape, without the room to grow."""
        self.reach(*shape)
        self._lengthen(shape[0])
        return self.values

    def _lengthen(self, length: int) -> None:
        """Change the first axis where the array lies, so that it is never held twice."""
        before = len(self.values)
        self.values.resize((length, *self.values.shape[1:]), refcheck=False)
        self.values[before:] = self._fill


class _Table:
    """The arrays of a table while its blocks come in."""

    finite = False

    def __init__(self, text: Any, axes: Sequence[str], columns: Sequence[str], fix: str) -> None:
        name = text.name
        self.lines = _Grid(name, 2, 0, np.uint32)  # of the row of an item and landmark; 0 is none
        self.points = _Grid(name, 3, np.nan, np.float64)
        self.confidence = _Grid(name, 2, 0.0, np.float64)
        self.sequence = _Grid(name, 1, -1, np.int64)
        self._place, self._axes, self._columns, self._fix = text.place, axes, columns, fix
        texts = ("item", "landmark", "sequence")
        self._numbers = {text: defaultdict[str, int](count().__next__) for text in texts}
        self._told: list[tuple[int, str]] = []

    def names(self, column: str) -> tuple[str, ...]:
        """Return the texts of a column in order of appearance."""
        return tuple(self._numbers[column])

    def take(self, block: Block) -> None:
        """Take the rows of a block; raises InputError for wrong ones."""
        known = len(self._numbers["item"])
        item, landmark = self._number(block, "item"), self._number(block, "landmark")
        n, p = len(self._numbers["item"]), len(self._numbers["landmark"])
        lines = self.lines.reach(n, p)
        place = item * p + landmark
        self._take_lines(block, place, lines.reshape(-1))
        if "sequence" in self._columns:
            self._take_sequences(block, item, known)
        columns = [self._coordinate(block, axis) for axis in self._axes]
        missing = np.isnan(columns).any(axis=0)
        points = self.points.reach(n, len(columns), p).reshape(-1)
        for axis, values in enumerate(columns):
            points[(item * len(columns) + axis) * p + landmark] = np.where(missing, np.nan, values)
        if "confidence" in self._columns:
            values, _ = _column(block, "confidence")
            wrong = ~(np.isfinite(values) & (values >= 0))
            self._note("confidence", block, wrong, "write 0 (hidden) or a positive number")
            self.confidence.reach(n, p).reshape(-1)[place] = values
        if self._told:
            told = [line for _, line in sorted(self._told, key=lambda entry: entry[0])]
            raise input_problems(told)

    def _number(self, block: Block, column: str) -> Integers:
        """Return the number of the text in each row; a new text gets the next one."""
        cells = block.cells[column]
        if column != "sequence" and "" in cells:
            unnamed = np.array([cell == "" for cell in cells])
            self._note(column, block, unnamed, f"name the {column}")
        number, period = self._numbers[column].__getitem__, len(self._numbers[column])
        if 0 < period < len(cells) and cells[period:] == cells[:-period]:  # as most tables repeat
            return np.resize(np.fromiter(map(number, cells[:period]), np.int64), len(cells))
        return np.fromiter(map(number, cells), np.int64, len(cells))

    def _take_lines(self, block: Block, place: Integers, lines: Integers) -> None:
        """Remember the first row of each item and landmark, and tell the others."""
        fresh = np.flatnonzero(lines[place] == 0)[::-1]  # of equal ones the first wins
        lines[place[fresh]] = block.lines[fresh]
        first = lines[place]
        for row in np.flatnonzero(first != block.lines).tolist():
            names = f"item '{block.cells['item'][row]}', landmark '{block.cells['landmark'][row]}'"
            found = f"{names} is also on line {first[row]}; keep one of them"
            self._tell(block, row, found)

    def _take_sequences(self, block: Block, item: Integers, known: int) -> None:
        """Take the sequence of each item from its first row, of new ones those from `known` on."""
        codes = self._number(block, "sequence")
        new = np.flatnonzero(item >= known)[::-1]  # of equal ones the first wins
        sequence = self.sequence.reach(len(self._numbers["item"]))
        sequence[item[new]] = codes[new]
        fix = "give all rows of an item one sequence"
        self._note("sequence", block, codes != sequence[item], fix)

    def _coordinate(self, block: Block, axis: str) -> Floats:
        values, strange = _column(block, axis)
        unfit = ~np.isfinite(values) if self.finite else np.isinf(values)
        self._note(axis, block, strange | unfit, self._fix)
        return values

    def _note(self, column: str, block: Block, wrong: NDArray[np.bool_], fix: str) -> None:
        """Note the wrong cells of a column."""
        for row in np.flatnonzero(wrong).tolist() if wrong.any() else ():
            cell = block.cells[column][row] if column in block.cells else block.numbers[column][row]
            found = "empty" if cell == "" else f"'{cell}'"
            self._tell(block, row, f"{column} is {found}; {fix}")

    def _tell(self, block: Block, row: int, found: str) -> None:
        line = int(block.lines[row])
        self._told.append((line, f"{self._place(line)}: {found}"))


def _column(block: Block, name: str) -> tuple[Floats, NDArray[np.bool_]]:
    if name in block.numbers:
        values = block.numbers[name]
        return values, np.zeros(len(values), bool)
    return read_numbers(block.cells[name])


def check_columns(
    columns: Sequence[str], required: Sequence[str], optional: Sequence[str], place: str
) -> None:
    """Raise InputError for columns that are unknown, there twice, or missing."""
    wanted = ",".join(required) + "".join(f"[,{column}]" for column in optional)
    known = {*required, *optional}
    told = []
    for column in columns:
        if column not in known:
            near = get_close_matches(column, known, n=1)
            fix = f"did you mean '{near[0]}'?" if near else f"the columns are {wanted}"
            told.append(f"{place}: unknown column '{column}'; {fix}")
        elif columns.count(column) > 1:
            told.append(f"{place}: the column '{column}' repeats; keep one of them")
    for column in required:
        if column not in columns:
            fix = f"the columns are {wanted}"
            told.append(f"{place}: there is no column '{column}'; {fix}")
    if told:
        raise input_problems(told)


# CSV text.

QUOTES = "put cells with commas or quotes in double quotes, and double the quotes in them"
COMMA, LINE_END = b",\n"


class CsvText:
    """The rows of a CSV file as blocks of cells; empty rows are dropped.

    `required` columns must be there, `optional` ones may, in any order. Where the header has
    spaces around its names, so have the cells, and they are taken away. Raises InputError for
    text that is not UTF-8 and for other columns.
    """

    def __init__(self, path: Path, required: Sequence[str], optional: Sequence[str]) -> None:
        self.name = source_name(path)
        texts = read_texts(path)
        _, text = next(texts)
        first, _, rest = text.partition("\n")
        self._texts = chain([(2, rest)] if rest else [], texts)
        try:
            header = next(csv.reader([first]), [])
        except csv.Error as error:
            raise _bad_line(f"{self.name}:1", error) from error
        self.columns = [column.strip() for column in header]
        self._spaced = self.columns != header
        known = {*required, *optional}
        if not known & set(self.columns):
            _refuse_header(first.strip(), self.columns, required, f"{self.name}:1")
        check_columns(self.columns, required, optional, f"{self.name}:1")

    def place(self, line: int) -> str:
        """Name a line in messages."""
        return f"{self.name}:{line}"

    def blocks(self) -> Iterator[Block]:
        """Give out all rows, once.

        Raises InputError for text that is not UTF-8, for cells that are no CSV and for rows with
        too few or too many cells.
        """
        for line, text in self._texts:
            columns = split_columns(text, len(self.columns))
            if columns is not None:
                yield self._block(columns, np.arange(line, line + len(columns[0])))
            else:
                following = (text for _, text in self._texts) if '"' in text else ()
                yield from self._read_rows(chain([text], following), line)

    def _read_rows(self, texts: Iterable[str], line: int) -> Iterator[Block]:
        rows = read_rows(texts, line, self.name)
        width = len(self.columns)
        while part := [row for row, _ in zip(rows, range(ROWS), strict=False)]:
            wrong = [(line, len(row)) for line, row in part if len(row) != width]
            if wrong:
                end = f"cells for {width} columns; write one cell per column"
                raise input_problems([f"{self.name}:{line}: has {n} {end}" for line, n in wrong])
            columns = list(zip(*(row for _, row in part), strict=True))
            yield self._block(columns, np.array([line for line, _ in part]))

    def _block(self, columns: Sequence[Sequence[str]], lines: NDArray[np.int64]) -> Block:
        if self._spaced:
            columns = [[cell.strip() for cell in column] for column in columns]
        return Block(dict(zip(self.columns, columns, strict=True)), lines)


def _refuse_header(first: str, columns: Sequence[str], required: Sequence[str], place: str) -> None:
    """Raise InputError for a header none of whose columns is known."""
    for letter, name in ((";", "semicolons"), ("\t", "tabs")):
        if letter in first and len(columns) == 1:
            fix = "save it with commas between the cells, and with decimal points"
            raise input_error(place, f"separates its cells by {name}", fix)
    if "frame_idx" in columns:
        fix = "give the .slp file, or export the analysis HDF5 file of SLEAP"
        raise input_error(place, "is one of SLEAP's tables, which are not read", fix)
    fix = f"write the header {','.join(required)}, with commas"
    raise input_error(place, f"the header is '{first[:80]}'", fix)


def read_texts(path: Path) -> Iterator[tuple[int, str]]:
    """Yield the text of standard input, a pipe or a file, whole lines and the first one's number.

    Lines that end in CR alone, as on old Macs, get the line ends of today. Raises InputError as
    `read_text_blocks` does, and for text that is not UTF-8.
    """
    name = source_name(path)
    line, rest, old = 1, b"", False
    for number, block in enumerate(read_text_blocks(path)):
        if number == 0:
            block = block.removeprefix(BYTE_ORDER_MARK)
            old = b"\r" in block and b"\n" not in block
        data = rest + (block.replace(b"\r", b"\n") if old else block)
        end = data.rfind(b"\n") + 1
        rest = data[end:]
        if len(rest) > csv.field_size_limit():
            fix = "check the quotes around it, and the ends of lines"
            raise input_error(f"{name}:{line}", "a bad cell (it has no end)", fix)
        if end:
            yield line, _decode(data[:end], line, name)
            line += data.count(b"\n", 0, end)
    if rest or line == 1:
        yield line, _decode(rest, line, name)


def _decode(data: bytes, line: int, name: str) -> str:
    fix = "save it as CSV in UTF-8"
    try:
        text = data.decode("utf-8")
    except UnicodeDecodeError as error:
        line += data.count(b"\n", 0, error.start)
        raise input_error(f"{name}:{line}", "is not UTF-8 text", fix) from error
    refuse_zero_bytes(text, name, line)
    return text


def refuse_zero_bytes(text: str, name: str, line: int) -> None:
    """Raise InputError for the line of a zero byte in a text that begins with this line."""
    if "\0" in text:
        line += text.count("\n", 0, text.index("\0"))
        fix = "save it as CSV in UTF-8"
        raise input_error(f"{name}:{line}", "is not text (a zero byte)", fix)


def split_columns(text: str, width: int) -> list[list[str]] | None:
    """Return the columns of lines that all have `width` cells, none of them quoted.

    None where it is not so plain; `read_rows` takes every text, and finds the same cells.
    """
    if "\r" in text:
        text = text.replace("\r\n", "\n")
    if '"' in text or "\r" in text:
        return None
    letters = np.frombuffer(text.removesuffix("\n").encode() + b"\n", np.uint8)
    ends, commas = np.flatnonzero(letters == LINE_END), np.flatnonzero(letters == COMMA)
    if len(commas) != len(ends) * (width - 1):
        return None
    between = commas.reshape(len(ends), width - 1)
    if (between[:, -1] > ends).any() or (between[1:, 0] < ends[:-1]).any():
        return None
    cells = text.removesuffix("\n").replace("\n", ",").split(",")
    columns = [cells[column::width] for column in range(width)]
    return None if "" in columns[0] else columns  # there may be an empty row


def read_rows(
    texts: Iterable[str], line: int, name: str, delimiter: str = ","
) -> Iterator[tuple[int, list[str]]]:
    """Yield line and cells of each row that is not empty; texts begin with `line`.

    Raises InputError after the last row that can be read, naming the line of the next one.
    """
    lines = chain.from_iterable(StringIO(text, newline="") for text in texts)
    reader = csv.reader(lines, delimiter=delimiter, strict=True)
    start = line
    try:
        for row in reader:
            if any(row):
                yield line, row
            line = start + reader.line_num
    except csv.Error as error:
        raise _bad_line(f"{name}:{line}", error) from error


def _bad_line(place: str, error: csv.Error) -> InputError:
    """Say what the csv module found at a place."""
    if "unexpected end" in str(error):
        return input_error(place, "a quote is never closed", QUOTES)
    return input_error(place, f"a bad cell ({error})", f"check the quotes around it: {QUOTES}")


_NUMBERS = {float, int}


def read_numbers(cells: Sequence[str]) -> tuple[Floats, NDArray[np.bool_]]:
    """Read decimal numbers, inf and nan; return them, and which cells are no number at all.

    Spaces around them do not count; an empty cell, and what is no number, is NaN.
    """
    none_strange = np.zeros(len(cells), bool)
    filled = [cell or "null" for cell in cells] if "" in cells else cells
    try:
        values = orjson.loads(f"[{','.join(filled)}]")  # four times as fast as float()
    except orjson.JSONDecodeError:
        values = []
    if len(values) == len(cells):
        kinds = set(map(type, values))
        if kinds <= _NUMBERS:
            return np.fromiter(values, np.float64, len(values)), none_strange
        if kinds <= {*_NUMBERS, type(None)} and values.count(None) == cells.count(""):
            return np.array(values, np.float64), none_strange
    numbers, strange = np.full(len(cells), math.nan), none_strange
    for row, cell in enumerate(cells):
        try:
            numbers[row] = _number(cell.strip())
        except ValueError:
            strange[row] = True
    return numbers, strange


def _number(cell: str) -> float:
    """Return what a cell says; float() alone would take 1_000 and the digits of all scripts."""
    if not cell:
        return math.nan
    if "_" in cell or not cell.isascii():
        raise ValueError
    return float(cell)
