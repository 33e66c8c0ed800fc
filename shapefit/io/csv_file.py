"""The tidy table as CSV, one row a landmark of an item: text to records, and records to
text.

Text is split at commas while it holds no quote; from the first quote on, and for lines
that do not fit, the csv module reads it.
"""

from __future__ import annotations

import csv
import pickle
import re
import sys
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from functools import lru_cache
from io import SEEK_END, StringIO
from itertools import chain, count, islice
from math import isnan
from pathlib import Path
from tempfile import TemporaryFile
from typing import IO, Any

import numpy as np
import orjson
from numpy.typing import NDArray

from shapefit import core
from shapefit.arrays import Flags, Floats, Integers
from shapefit.errors import input_error
from shapefit.io.arrange import arrange
from shapefit.io.atomic import OF_THE_DISK, atomic_path, storage_errors
from shapefit.io.checks import LIMIT, input_problems
from shapefit.io.inputs import (
    check_fits,
    is_stream,
    read_head,
    read_text_blocks,
    source_name,
)
from shapefit.io.layout import FRAME, TIME
from shapefit.io.options import RecordWriter, Summary
from shapefit.records.fit import Fit
from shapefit.records.frames import check_frames, order_by_frame
from shapefit.records.items import Items, concatenate
from shapefit.records.landmarks import Landmarks
from shapefit.records.names import as_composed
from shapefit.records.shapes import Shapes
from shapefit.timeline import find_rate

ROWS = 1 << 12
"""Rows that are read and written at a time: more leave the processor's cache, and take
longer.
"""

QUOTES = (
    "put cells with commas or quotes in double quotes, and double the quotes in them"
)

RowBlock = tuple[Integers, dict[str, Sequence[str]]]
"""The lines of some rows, and their cells by column."""

OF_ITEMS = ("sequence", FRAME, TIME)
"""Columns that say the same in all rows of an item."""

OPTIONAL_COLUMNS = {
    "landmarks": ("confidence", *OF_ITEMS),
    "shapes": (*OF_ITEMS, "sd_x", "sd_y", "sd_z", "modes", "trusted", "reasons"),
}
"""Columns that may be there; of shapes and results those of items alone are read
back.
"""

ROW_NUMBERS = ""
"""Name of a first column that is passed over: pandas numbers the rows in it."""

MOST_FRAME = 2.0**53
"""Beyond it whole numbers are not told apart."""

FINITE_OR_EMPTY = "write a finite number, or leave the cell empty where it is unknown"

MISSED = -1.0
"""Both coordinates of a landmark without confidence that was not found."""

MOST_EMPTY = 1 << 15
"""Bytes of empty lines from which they are passed over: a file can be full of them, but
no name is.
"""

MAX_IN_MEMORY = 1 << 19
"""Rows of a table that are held; more go to a temporary file, item by item, if the rows
of items stand together.
"""

ROW_BYTES = 100
"""Memory that a row takes in which items do not stand together, while it is read."""

QUOTED = re.compile('[",\r\n]')
"""What a cell has in quotes."""

NUMBER_CHARACTERS = 26
"""Bytes of a number with the comma behind it, at most."""

Y_UP = "y points up, which CSV cannot say: read the file with `y_axis=up`"


def without_row_numbers(columns: Sequence[str]) -> Sequence[str]:
    """Return the columns of a table but for the row numbers that pandas writes."""
    return columns[1:] if columns[:1] == [ROW_NUMBERS] else columns


def csv_kind(path: Path) -> str:
    """Return what a table holds: landmarks, or shapes where it has the column z."""
    columns, _ = open_table(path)
    return "shapes" if "z" in columns else "landmarks"


def read_csv(path: Path, kind: str) -> Items | Spool:
    """Read a tidy table of ours as records, or as a Spool of many landmarks.

    Its columns are `item,landmark,x,y[,confidence]` or `item,landmark,x,y,z`, each with
    `[,sequence][,frame][,time]`. A landmark that has no row or lacks a coordinate is
    NaN, its confidence 0. Items are put in order of their frames, and those in memory
    have the frame rate of their times. Raises InputError for the first wrong cells, by
    line, and where memory does not hold a large table in which the rows of an item do
    not stand together, or frames are not in order, which cannot go to a file item by
    item.
    """
    table = Table(path, kind)
    spool = Spool()
    for lines, cells in table.blocks:
        table.take(lines, cells)
        if table.size <= MAX_IN_MEMORY:
            continue
        if kind == "landmarks" and table.in_order:
            spool.append(table.pop_complete())
        else:
            check_fits(table.name, table.size * ROW_BYTES)
    rest = table.records()
    if not len(spool):
        return _in_time(rest, table.numbered, table.name)
    spool.append(rest)
    together = len(np.unique(np.concatenate(spool.hashes))) == len(spool)
    if together and spool.in_order:
        return spool
    if not path.is_file():
        fault = "frames of a sequence are not in order, and the table is large"
        fix = "name the file itself, or sort its rows by sequence and frame"
        if not together:
            fault = "the rows of items do not stand together, and the table is large"
            fix = "name the file itself, or sort its rows by item"
        raise input_error(table.name, fault, fix)
    return _read_unordered(path, kind)


def _in_time(records: Items, numbered: bool, name: str) -> Items:
    """Return records in order of their frames, with the frame rate of their times.

    Those that are not `numbered`, whose column of frames is empty, are without frames.
    Raises InputError where a sequence has two items in one frame.
    """
    if not numbered and len(records):
        records = replace(records, frames=None)
    check_frames(records.sequences, records.frames, records.items, name)
    order = order_by_frame(records.sequences, records.frames)
    if order is not None:
        records = records.take(order)
    rate = find_rate(records.frames, records.times)
    return replace(records, frame_rate=rate)


def _read_unordered(path: Path, kind: str) -> Items:
    """Read a large table of items or frames out of order once more, into memory.

    Rows of an item do not stand together, as pandas' `melt` leaves them, or frames are
    not in order. Raises InputError where memory is too little.
    """
    table = Table(path, kind)
    for lines, cells in table.blocks:
        table.take(lines, cells)
        check_fits(table.name, table.size * ROW_BYTES)
    return _in_time(table.records(), table.numbered, table.name)


def read_csv_head(path: Path, kind: str) -> tuple[Items, float]:
    """Read the first rows of a table, and return them with their share of all rows."""
    table, share = Table(path, kind), 1.0
    for lines, cells in table.blocks:
        table.take(lines, cells)
        if table.size > MAX_IN_MEMORY // 4 and path.is_file():
            text = read_head(path, 1 << 20)
            share = min(
                table.size * len(text) / text.count(b"\n") / path.stat().st_size, 1.0
            )
            break
    return _in_time(table.records(), table.numbered, table.name), share


class Table:
    """Collects the rows of a table, block by block, and makes records of them.

    It holds numbers of items and landmarks, and values.
    """

    def __init__(self, path: Path, kind: str, *, live: bool = False) -> None:
        """Open a table; InputError for columns unknown, there twice, or missing.

        With `live` it is standard input, whose rows are taken as they come.
        """
        self.name, self._kind = source_name(path), kind
        columns, self.blocks = open_table(path, live=live)
        required = (
            "item",
            "landmark",
            "x",
            "y",
            *(() if kind == "landmarks" else ("z",)),
        )
        optional = OPTIONAL_COLUMNS.get(kind, OPTIONAL_COLUMNS["shapes"])
        unknown = {*without_row_numbers(columns)} - {*required, *optional}
        if unknown or {*required} - {*columns} or len({*columns}) < len(columns):
            wanted = ",".join(required) + "".join(f"[,{column}]" for column in optional)
            fault = f"the header is '{','.join(columns)[:80]}'"
            raise input_error(
                f"{self.name}:1", fault, f"write the header {wanted}, with commas"
            )
        self._axes = ("x", "y") if kind == "landmarks" else ("x", "y", "z")
        self._scored = kind == "landmarks" and "confidence" in columns
        self._of_items: dict[str, dict[str, str]] = {
            column: {} for column in OF_ITEMS if column in columns
        }
        self._items = _numbering()
        self._landmarks = _numbering()
        self._parts: list[tuple[Any, ...]] = []
        self._last = 0
        self.size = 0
        self.in_order = True
        self.numbered = False

    def take(self, lines: Integers, cells: Mapping[str, Sequence[str]]) -> None:
        """Add rows, given by their lines and their cells by column.

        Raises InputError for wrong cells.
        """
        faults = _Faults(self.name, lines, cells)
        for column in ("item", "landmark"):
            if "" in cells[column]:
                empty = np.array([text == "" for text in cells[column]])
                faults.note(column, empty, f"name the {column}")
        item = _numbers_of(cells["item"], self._items)
        landmark = _numbers_of(cells["landmark"], self._landmarks)
        self._take_columns_of_items(cells, faults)
        points = []
        for axis in self._axes:
            values, invalid = read_numbers(cells[axis])
            faults.note(axis, invalid | np.isinf(values), FINITE_OR_EMPTY)
            points.append(values)
        missing = np.isnan(points).any(axis=0)
        confidence = np.zeros(len(lines))
        if self._scored:
            confidence, _ = read_numbers(cells["confidence"])
            wrong = ~(np.isfinite(confidence) & (confidence >= 0))
            fix = "write 0 (hidden) or a positive number"
            faults.note("confidence", wrong, fix)
        if self._kind == "landmarks":  # as some detectors write what they miss
            missing |= (np.array(points) == MISSED).all(axis=0) & ~(confidence > 0)
        for values in points:
            values[missing] = np.nan
        faults.check()
        steps = np.diff(item, prepend=self._last)
        self.in_order = self.in_order and not (steps < 0).any()
        self._last = int(item[-1]) if len(item) else self._last
        self.size += len(lines)
        self._parts.append(
            (lines.astype(np.int32), item, landmark, *points, confidence)
        )

    def _take_columns_of_items(
        self, cells: Mapping[str, Sequence[str]], faults: _Faults
    ) -> None:
        """Store what rows of an item share: sequence, frame, time; note wrong cells."""
        for column, of_item in self._of_items.items():
            first = [*map(of_item.setdefault, cells["item"], cells[column])]
            if first != [*cells[column]]:
                wrong = np.array(first, object) != np.array(cells[column], object)
                faults.note(column, wrong, f"give all rows of an item one {column}")
        if FRAME in self._of_items:
            numbers, invalid = read_numbers(cells[FRAME])
            whole = (np.abs(numbers) < MOST_FRAME) & (numbers % 1 == 0)
            self.numbered = self.numbered or any(cells[FRAME])
            sequences = cells.get("sequence", ())
            single = np.array([not sequence for sequence in sequences], bool)
            if len(single):  # images of no sequence need no number
                whole |= single & np.isnan(numbers)
            faults.note(FRAME, invalid | ~whole, "write a whole number")
        if TIME in self._of_items:
            seconds, invalid = read_numbers(cells[TIME])
            wrong = invalid | np.isinf(seconds)
            faults.note(TIME, wrong, f"{FINITE_OR_EMPTY} (seconds)")

    def records(self) -> Items:
        """Return the rows so far as one record of the table's kind.

        Raises InputError for double rows, and where memory is too little.
        """
        items = tuple(self._items)
        n = len(items)
        p = len(self._landmarks)
        d = len(self._axes)
        check_fits(self.name, n * p * 8 * (d + 3))
        planes = self._planes()
        points = np.ascontiguousarray(planes[:d].reshape(d, n, p).transpose(1, 2, 0))
        cells = {
            column: [of_item[name] for name in items]
            for column, of_item in self._of_items.items()
        }
        frames = None
        if FRAME in cells:
            numbers, _ = read_numbers(cells[FRAME])
            frames = np.nan_to_num(numbers).astype(np.int64)
        times = None
        if TIME in cells:
            times, _ = read_numbers(cells[TIME])
        of_items: dict[str, Any] = {
            "landmark_names": tuple(self._landmarks),
            "items": items,
            "sequences": cells.get("sequence"),
            "frames": frames,
            "times": times,
        }
        if self._kind == "shapes":
            return Shapes(points, **of_items)
        if self._kind == "result":
            return Fit(points, **of_items)
        confidence = None
        if self._scored:
            confidence = np.nan_to_num(planes[d]).reshape(n, p)
        return Landmarks(points, confidence=confidence, **of_items)

    def _planes(self) -> Floats:
        """Return coordinates and confidence (d + 1, n p) of the rows so far.

        NaN for landmarks that an item lacks. Raises InputError for double rows.
        """
        places = len(self._items) * len(self._landmarks)
        planes = np.full((len(self._axes) + 1, places), np.nan)
        if not self._parts:
            return planes
        lines, item, landmark, *values = map(
            np.concatenate, zip(*self._parts, strict=True)
        )
        self._parts = [(lines, item, landmark, *values)]
        place = item * np.int64(len(self._landmarks)) + landmark
        row = np.arange(len(lines))
        first = np.full(places, -1)
        first[place[::-1]] = row[::-1]
        again = np.flatnonzero(first[place] != row)
        if len(again):
            items = tuple(self._items)
            names = tuple(self._landmarks)
            problems = [
                f"{self.name}:{lines[k]}: item '{items[item[k]]}', landmark "
                f"'{names[landmark[k]]}' is also on line {lines[first[place[k]]]}; "
                "keep one of them"
                for k in again[:LIMIT]
            ]
            raise input_problems(problems, len(again))
        for plane, column in zip(planes, values, strict=True):
            plane[place] = column
        return planes

    def pop_all(self) -> Items:
        """Remove and return all items; their landmarks stay those of the table."""
        images = self.records()
        self._parts = []
        self._items = _numbering()
        self._of_items = {column: {} for column in self._of_items}
        self.size = 0
        self._last = 0
        return images if self.numbered else replace(images, frames=None)

    def pop_complete(self) -> Items:
        """Remove and return all items but the last, of which more rows may come."""
        images = self.records()
        last = len(images) - 1
        item, (lines, items, *values) = images.items[last], self._parts[0]
        rows = np.flatnonzero(items == last)
        remaining = (
            lines[rows],
            np.zeros_like(items[rows]),
            *(column[rows] for column in values),
        )
        self._parts = [remaining]
        self._items = _numbering(item)
        self.size = len(rows)
        self._last = 0
        for column, of_item in self._of_items.items():
            self._of_items[column] = {item: of_item[item]}
        return images.take(slice(0, last))


class _Faults:
    """What is wrong with cells of some rows, by row."""

    def __init__(
        self, name: str, lines: Integers, cells: Mapping[str, Sequence[str]]
    ) -> None:
        """Take a file's name, and the lines and cells of rows; nothing is noted yet."""
        self._name = name
        self._lines = lines
        self._cells = cells
        self._problems: list[tuple[int, str]] = []

    def note(self, column: str, wrong: Flags, fix: str) -> None:
        """Note the rows (n,) whose cell in a column is wrong, and what to write."""
        for row in np.flatnonzero(wrong).tolist():
            cell = self._cells[column][row]
            fault = f"is '{cell}'" if cell else "is empty"
            place = f"{self._name}:{self._lines[row]}"
            self._problems.append((row, f"{place}: {column} {fault}; {fix}"))

    def check(self) -> None:
        """Raise InputError, row by row, where anything was noted."""
        if self._problems:
            ordered = sorted(self._problems, key=lambda problem: problem[0])
            raise input_problems([text for _, text in ordered])


def _numbering(*texts: str) -> defaultdict[str, int]:
    """Return a dictionary that gives the next number to each new text.

    `texts` are numbered first, from 0.
    """
    return defaultdict(count(len(texts)).__next__, zip(texts, count()))


def _numbers_of(
    texts: Sequence[str], numbering: defaultdict[str, int]
) -> NDArray[np.int32]:
    """Return the number of each text, new ones numbered as they come."""
    return np.fromiter(map(numbering.__getitem__, texts), np.int32, len(texts))


class Spool:
    """Images of a large table in a temporary file, in parts; the last read is kept."""

    def __init__(self) -> None:
        self._names: Sequence[str] = ()
        self._file = TemporaryFile()  # noqa: SIM115 gone with the source
        self._starts, self._offsets = [0], list[int]()
        self.hashes: list[NDArray[np.int64]] = []
        self._last_frame: dict[str, int] = {}
        self.in_order = True
        self._part = lru_cache(1)(self._read)

    def __len__(self) -> int:
        return self._starts[-1]

    def append(self, images: Items) -> None:
        """Write images after those that are there."""
        self._names = images.landmark_names
        self._offsets.append(self._file.seek(0, SEEK_END))
        self._starts.append(len(self) + len(images))
        self.hashes.append(np.fromiter(map(hash, images.items), np.int64, len(images)))
        if images.sequences is not None and images.frames is not None:
            frames = zip(images.sequences, images.frames.tolist(), strict=True)
            for sequence, frame in frames:
                before = self._last_frame.get(sequence, frame)
                rises = sequence not in self._last_frame or before < frame
                self.in_order &= rises or not sequence
                self._last_frame[sequence] = frame
        pickle.dump(images, self._file, pickle.HIGHEST_PROTOCOL)

    def take(self, rows: slice) -> Items:
        """Return the images of these rows."""
        parts = []
        for number, start in enumerate(self._starts[:-1]):
            inner = slice(max(rows.start - start, 0), rows.stop - start)
            if (start <= rows.start or inner.stop > 0) and rows.start < self._starts[
                number + 1
            ]:
                parts.append(self._part(number).take(inner))
        return concatenate(parts)

    def _read(self, number: int) -> Items:
        """Read the images of a part; landmarks that came later are unseen in it."""
        self._file.seek(self._offsets[number])
        images: Items = pickle.load(self._file)
        return arrange(images, self._names)


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


def open_table(
    path: Path, *, live: bool = False
) -> tuple[list[str], Iterator[RowBlock]]:
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

    def blocks() -> Iterator[RowBlock]:
        rows = chain([(2, rest)], texts)
        for lines, cells in _divided(rows, len(columns), name, at_once):
            if columns != header:
                cells = [[cell.strip() for cell in column] for column in cells]
            yield lines, dict(zip(columns, cells, strict=True))

    return columns, blocks()


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
        if end > MOST_EMPTY and line > 1 and not data[:end].strip():
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
    texts: Iterator[tuple[int, str]], width: int, name: str, at_once: int
) -> Iterator[tuple[Integers, Sequence[Sequence[str]]]]:
    """Yield rows of texts, block by block: their line numbers, and their columns.

    From the first quote on, a block has `at_once` rows. Raises InputError for rows that
    do not have `width` cells, and for wrong quotes.
    """
    for line, text in texts:
        columns = split_columns(text, width)
        if columns is not None:
            yield np.arange(line, line + len(columns[0])), columns
            continue
        following = (text for _, text in texts) if '"' in text else ()
        rows = read_rows(chain([text], following), line, name)
        while part := [*islice(rows, at_once)]:
            if wrong := [(at, len(row)) for at, row in part if len(row) != width]:
                end = f"cells for {width} columns; write one cell per column"
                raise input_problems([f"{name}:{at}: has {n} {end}" for at, n in wrong])
            yield (
                np.array([at for at, _ in part]),
                [*zip(*(row for _, row in part), strict=True)],
            )


def split_columns(text: str, width: int) -> list[list[str]] | None:
    """Return the columns of lines with `width` unquoted cells each, None for others.

    `read_rows` takes every text, and finds the same cells.
    """
    text = text.replace("\r\n", "\n") if "\r" in text else text
    if '"' in text or "\r" in text:
        return None
    text = text.removesuffix("\n")
    letters = np.frombuffer(text.encode() + b"\n", np.uint8)
    marks = letters[(letters == ord(",")) | (letters == ord("\n"))]
    ends = np.flatnonzero(marks == ord("\n"))
    if not np.array_equal(ends, np.arange(width - 1, len(marks), width)):
        return None
    cells = text.replace("\n", ",").split(",")
    columns = [cells[column::width] for column in range(width)]
    return None if "" in columns[0] else columns  # there may be an empty row


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


@contextmanager
def csv_output(target: Path) -> Iterator[CsvWriter]:
    """Give a CsvWriter to a file that appears on a clean exit; to stdout for `-`."""
    with ExitStack() as stack:
        file: IO[bytes]
        if is_stream(target):
            if sys.stdout is None:
                raise input_error(
                    "standard output", "is closed", "name a file to write instead"
                )
            file, place, numbers = (
                sys.stdout.buffer,
                Path("standard output"),
                OF_THE_DISK,
            )
        else:
            path = stack.enter_context(atomic_path(target))
            file, place, numbers = stack.enter_context(path.open("wb")), target, None

        def write(data: bytes | memoryview) -> None:
            with storage_errors(place, numbers):
                file.write(data)
                file.flush()

        writer = CsvWriter(write)
        yield writer
        writer.check_begun()


class CsvWriter(RecordWriter[Items]):
    """Appends records as rows
    `item,landmark,x,y[,z][,confidence][,sd_x,sd_y,sd_z][,sequence][,frame][,time]`.

    Results with a verdict also have a column `trusted`. NaN becomes an empty cell;
    numbers have the fewest digits that read back to the same float. CSV has no place
    for `attributes`.
    """

    def __init__(self, write: Callable[[bytes | memoryview], object]) -> None:
        super().__init__()
        self._write = write
        self._header = b""

    def append(self, record: Items) -> None:
        """Write one row for each landmark of each item.

        Raises ValueError where the columns are not those of the first record.
        """
        numbers, texts = _columns(record)
        header = ",".join(["item", "landmark", *numbers, *texts]).encode()
        if not self.begun:
            self.begun, self._header = True, header
            self._write(header + b"\n")
        elif header != self._header:
            raise ValueError("the columns of this record are not those of the first")
        if record.y_axis == "up":
            self.summary = Summary(warnings=(Y_UP,))
        items = max(1, ROWS // max(1, len(record.landmark_names)))
        for start in range(0, len(record), items):
            self._write(_lines(record.take(slice(start, start + items))))


def _columns(record: Items) -> tuple[dict[str, Floats], dict[str, Sequence[str]]]:
    """Return the columns beside item and landmark: numbers (n, p), and texts (n,)."""
    d = record.points.shape[2]
    numbers = {"xyz"[axis]: record.points[..., axis] for axis in range(d)}
    texts: dict[str, Sequence[str]] = {}
    if isinstance(record, Landmarks) and record.confidence is not None:
        numbers["confidence"] = record.confidence
    if record.sequences is not None:
        texts["sequence"] = record.sequences
    if record.frames is not None:
        texts[FRAME] = [*map(str, record.frames.tolist())]
    if record.times is not None:
        times = record.times.tolist()
        texts[TIME] = ["" if isnan(time) else repr(time) for time in times]
    if isinstance(record, Fit) and record.shape_sd is not None:
        for axis in range(d):
            numbers[f"sd_{'xyz'[axis]}"] = record.shape_sd[..., axis]
    if isinstance(record, Fit) and record.trusted is not None:
        answers = record.trusted.tolist()
        texts["trusted"] = ["true" if answer else "false" for answer in answers]
    return numbers, texts


def _lines(record: Items) -> memoryview:
    """Return the rows of CSV of a record, without a header, as bytes."""
    n = len(record)
    p = len(record.landmark_names)
    numbers, texts = _columns(record)
    item, landmark = np.divmod(np.arange(n * p), max(p, 1))
    numbers_of = [
        item,
        landmark + n,
        *(item + n * k + p for k in range(1, len(texts) + 1)),
    ]
    cells = [
        *map(
            _encoded_texts, chain(record.items, record.landmark_names, *texts.values())
        )
    ]
    starts = np.cumsum([0, *map(len, cells)])
    rows_of = np.column_stack(numbers_of)
    values = np.stack([*numbers.values()], axis=-1).reshape(n * p, len(numbers))
    letters = b"".join(cells)
    capacity = (
        int(np.diff(starts)[rows_of].sum())
        + rows_of.size
        + NUMBER_CHARACTERS * values.size
    )
    rows = np.empty(capacity // 8 + 1, np.uint64)
    size = core.write_csv_rows(
        letters=np.frombuffer(letters.ljust(len(letters) // 8 * 8 + 8), np.uint64),
        starts=starts,
        texts=rows_of,
        numbers=values,
        leading=2,
        as_python=False,
        rows=rows,
    )
    return rows.view(np.uint8)[:size].data


def _encoded_texts(text: str) -> bytes:
    """Return a text as a cell of CSV in UTF-8, in quotes where it needs them."""
    if not text or QUOTED.search(text):
        text = '"{}"'.format(text.replace('"', '""'))
    return text.encode()
