"""The tidy table as CSV, one row a landmark of an item: cells to records, and records
to text.
"""

from __future__ import annotations

import pickle
import sys
from bisect import bisect_left, bisect_right
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from functools import lru_cache
from io import SEEK_END
from itertools import chain, count
from math import isnan
from pathlib import Path
from tempfile import TemporaryFile
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Flags, Floats, are_whole
from shapefit.errors import input_error
from shapefit.io.arrange import arrange
from shapefit.io.atomic import OF_THE_DISK, atomic_path, storage_errors
from shapefit.io.checks import LIMIT, input_problems
from shapefit.io.csv_cells import ROWS, Cells, open_table, read_numbers
from shapefit.io.csv_rows import csv_cell, format_rows
from shapefit.io.inputs import (
    check_fits,
    is_stream,
    read_head,
    source_name,
)
from shapefit.io.layout import FRAME, TIME
from shapefit.io.options import RecordWriter, Summary
from shapefit.records.fit import Fit
from shapefit.records.frames import check_frames, order_by_frame
from shapefit.records.items import Items, concatenate
from shapefit.records.landmarks import Landmarks
from shapefit.records.shapes import Shapes
from shapefit.timeline import find_rate

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

FINITE_OR_EMPTY = "write a finite number, or leave the cell empty where it is unknown"

MISSED = -1.0
"""Both coordinates of a landmark without confidence that was not found."""

MAX_IN_MEMORY = 1 << 19
"""Rows of a table that are held; more go to a temporary file, item by item, if the rows
of items stand together.
"""

MAX_PART = 1 << 16
"""Rows that go to the temporary file together, once it is there: with as many as are
held in memory, which leave the processor's cache, a table takes an eighth longer.
"""

ROW_BYTES = 100
"""Memory that a row takes in which items do not stand together, while it is read."""

Y_UP = "y points up, which CSV cannot say: read the file with `y_axis=up`"


def without_row_numbers(columns: Sequence[str]) -> Sequence[str]:
    """Return column names without the nameless first one, where pandas counts rows."""
    return columns[1:] if columns[:1] == [ROW_NUMBERS] else columns


def csv_kind(path: Path) -> str:
    """Return the kind of a table: landmarks, or shapes where it has a column z."""
    columns, _ = open_table(path)
    return "shapes" if "z" in columns else "landmarks"


def read_csv(path: Path, kind: str) -> Items | Spool:
    """Read a tidy CSV table as one record, or as a Spool on disk if it is large.

    Its columns are `item,landmark,x,y[,confidence]` or `item,landmark,x,y,z`, each with
    `[,sequence][,frame][,time]`. A landmark that has no row or lacks a coordinate is
    NaN, its confidence 0. Items are put in order of their frames, and those in memory
    have the frame rate of their times. Raises InputError for the first wrong cells, by
    line, and where memory does not hold a large table in which the rows of an item do
    not stand together, or frames are not in order, which cannot go to a file item by
    item.
    """
    table = Table(path, kind)
    spool: Spool | None = None
    max_rows = MAX_IN_MEMORY
    for cells in table.blocks:
        table.add(cells)
        if table.size <= max_rows:
            continue
        if kind == "landmarks" and table.in_order:
            spool = spool or Spool()
            spool.append(table.pop_complete())
            max_rows = min(MAX_PART, MAX_IN_MEMORY)
        else:
            check_fits(table.name, table.size * ROW_BYTES)
    rest = table.to_record()
    if not spool:  # or nothing was moved to it
        return _sort_by_frame(rest, table.numbered, table.name)
    spool.append(rest)
    hashes = np.sort(np.concatenate(spool.hashes))
    together = not (hashes[1:] == hashes[:-1]).any()
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


def _sort_by_frame(record: Items, numbered: bool, name: str) -> Items:
    """Sort items by sequence and frame, and set the frame rate found from their times.

    Items that are not `numbered`, whose column of frames is empty, lose their frames.
    Raises InputError where a sequence has two items in one frame.
    """
    if not numbered and len(record):
        record = replace(record, frames=None)
    check_frames(record.sequences, record.frames, record.items, name)
    order = order_by_frame(record.sequences, record.frames)
    if order is not None:
        record = record.take(order)
    rate = find_rate(record.frames, record.times)
    return record if rate == record.frame_rate else replace(record, frame_rate=rate)


def _read_unordered(path: Path, kind: str) -> Items:
    """Read a large table, in any order of rows, into memory; sort items by frame.

    Rows of an item do not stand together, as pandas' `melt` leaves them, or frames are
    not in order. Raises InputError where memory is too little.
    """
    table = Table(path, kind)
    for cells in table.blocks:
        table.add(cells)
        check_fits(table.name, table.size * ROW_BYTES)
    return _sort_by_frame(table.to_record(), table.numbered, table.name)


def read_csv_head(path: Path, kind: str) -> tuple[Items, float]:
    """Read the first rows of a table; return them, and their share of the file."""
    table, share = Table(path, kind), 1.0
    for cells in table.blocks:
        table.add(cells)
        if table.size > MAX_IN_MEMORY // 4 and path.is_file():
            text = read_head(path, 1 << 20)
            share = min(
                table.size * len(text) / text.count(b"\n") / path.stat().st_size, 1.0
            )
            break
    return _sort_by_frame(table.to_record(), table.numbered, table.name), share


class Table:
    """Collects the rows of a table, block by block, and makes records of them.

    It holds numbers of items and landmarks, and values.
    """

    def __init__(self, path: Path, kind: str, *, live: bool = False) -> None:
        """Open a table of records of `kind`, and check the names of its columns.

        With `live` it is standard input, whose rows are taken as they come. Raises
        InputError for columns unknown, there twice, or missing.
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
        self._of_items = {
            column: _ItemColumn() for column in OF_ITEMS if column in columns
        }
        self._items = _make_numbering()
        self._landmarks = _make_numbering()
        self._parts: list[tuple[Any, ...]] = []
        self._last = 0
        self.size = 0
        self.in_order = True
        self.numbered = False

    def add(self, cells: Cells) -> None:
        """Add the rows of these cells; raises InputError for wrong cells."""
        faults = _Faults(self.name, cells)
        item = self._number_names("item", self._items, cells, faults)
        landmark = self._number_names("landmark", self._landmarks, cells, faults)
        self._add_item_columns(cells, item, faults)
        points = []
        for axis in self._axes:
            values, invalid = cells.numbers(axis)
            faults.note(axis, invalid | np.isinf(values), FINITE_OR_EMPTY)
            points.append(values)
        missing = np.isnan(points).any(axis=0)
        missed = (np.array(points) == MISSED).all(axis=0)
        scores = []
        if self._scored:
            confidence, _ = cells.numbers("confidence")
            wrong = ~(np.isfinite(confidence) & (confidence >= 0))
            fix = "write 0 (hidden) or a positive number"
            faults.note("confidence", wrong, fix)
            missed &= ~(confidence > 0)
            scores.append(confidence)
        faults.check()
        if self._kind == "landmarks":  # as some detectors write what they miss
            missing |= missed
        placed = np.stack(points, axis=1)
        placed[missing] = np.nan
        if len(item):
            falls = item[0] < self._last or (item[1:] < item[:-1]).any()
            self.in_order = self.in_order and not falls
            self._last = int(item[-1])
        self.size += len(cells.lines)
        lines = cells.lines.astype(np.int32)
        self._parts.append((lines, item, landmark, placed, *scores))

    def _number_names(
        self,
        column: str,
        numbering: defaultdict[str, int],
        cells: Cells,
        faults: _Faults,
    ) -> NDArray[np.int32]:
        """Return the number (n,) of each row's name; note empty names as faults.

        New names get the next numbers.
        """
        texts_of_rows, texts = cells.unique_texts(column)
        if "" in texts:
            empty = texts_of_rows == texts.index("")
            faults.note(column, empty, f"name the {column}")
        return _number_texts(column, numbering, cells)

    def _add_item_columns(
        self, cells: Cells, item: NDArray[np.int32], faults: _Faults
    ) -> None:
        """Store the sequence, frame and time of each item; note wrong cells as faults.

        All rows of an item must have the same. item (n,): numbers of the rows' items.
        """
        for column, of_item in self._of_items.items():
            fix = f"give all rows of an item one {column}"
            faults.note(column, of_item.add(column, cells, item), fix)
        if FRAME in self._of_items:
            numbers, invalid = cells.numbers(FRAME)
            whole = are_whole(numbers)
            self.numbered = self.numbered or any(cells.unique_texts(FRAME)[1])
            if "sequence" in self._of_items:  # images of no sequence need no number
                texts_of_rows, texts = cells.unique_texts("sequence")
                single = np.array([not text for text in texts], bool)
                whole |= single[texts_of_rows] & np.isnan(numbers)
            faults.note(FRAME, invalid | ~whole, "write a whole number")
        if TIME in self._of_items:
            seconds, invalid = cells.numbers(TIME)
            wrong = invalid | np.isinf(seconds)
            faults.note(TIME, wrong, f"{FINITE_OR_EMPTY} (seconds)")

    def to_record(self) -> Items:
        """Return all rows added so far as one record of the table's kind.

        Raises InputError for double rows, and where memory is too little.
        """
        items = tuple(self._items)
        n = len(items)
        p = len(self._landmarks)
        d = len(self._axes)
        check_fits(self.name, n * p * 8 * (d + 3))
        points, *scores = self._by_place()
        points = points.reshape(n, p, d)
        cells = {column: of_item.texts() for column, of_item in self._of_items.items()}
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
            confidence = np.nan_to_num(scores[0]).reshape(n, p)
        return Landmarks(points, confidence=confidence, **of_items)

    def _by_place(self) -> list[Floats]:
        """Return coordinates (n p, d) of all items and landmarks, one item's together.

        Behind them the confidence (n p,), where the table has one. Both are NaN for
        landmarks that an item lacks. Raises InputError for double rows.
        """
        places = len(self._items) * len(self._landmarks)
        if not self._parts:
            return [np.empty((0, len(self._axes))), np.empty(0)]
        lines, item, landmark, *values = self._join_parts()
        place = item * np.int64(len(self._landmarks)) + landmark
        row = np.arange(len(lines))
        if len(row) == places and np.array_equal(place, row):  # as most tables are
            return values
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
        by_place = [np.full((places, *column.shape[1:]), np.nan) for column in values]
        for filled, column in zip(by_place, values, strict=True):
            filled[place] = column
        return by_place

    def _join_parts(self) -> tuple[Any, ...]:
        """Join the parts of the table to one, and return it: columns of all rows."""
        if len(self._parts) > 1:
            self._parts = [tuple(map(np.concatenate, zip(*self._parts, strict=True)))]
        return self._parts[0]

    def pop_all(self) -> Items:
        """Remove all items, and return them as a record; keep the landmark names."""
        images = self.to_record()
        self._parts = []
        self._items = _make_numbering()
        self._of_items = {column: _ItemColumn() for column in self._of_items}
        self.size = 0
        self._last = 0
        return images if self.numbered else replace(images, frames=None)

    def pop_complete(self) -> Items:
        """Remove and return all items but the last, of which more rows may come.

        The rows of each item must stand together, see `in_order`.
        """
        lines, item, landmark, *values = self._join_parts()
        name, last = self._items.popitem()
        texts = {column: of_item.pop() for column, of_item in self._of_items.items()}
        end = int(np.searchsorted(item, last))
        whole = (lines, item, landmark, *values)
        self._parts = [tuple(column[:end] for column in whole)]
        images = self.to_record()
        rest = (lines, np.zeros_like(item), landmark, *values)
        self._parts = [tuple(column[end:].copy() for column in rest)]
        self._items = _make_numbering(name)
        self._of_items = {column: _ItemColumn(text) for column, text in texts.items()}
        self.size = len(item) - end
        self._last = 0
        return images


class _Faults:
    """Collects messages about wrong cells of a block of rows."""

    def __init__(self, name: str, cells: Cells) -> None:
        """Take a file's name, for messages, and the cells of a block of rows."""
        self._name = name
        self._cells = cells
        self._problems: list[tuple[int, str]] = []

    def note(self, column: str, wrong: Flags, fix: str) -> None:
        """Add a message on the column's cell in each row where `wrong` (n,) is True.

        `fix` says what to write there.
        """
        for row in np.flatnonzero(wrong).tolist():
            cell = self._cells.cell(column, row)
            fault = f"is '{cell}'" if cell else "is empty"
            place = f"{self._name}:{self._cells.lines[row]}"
            self._problems.append((row, f"{place}: {column} {fault}; {fix}"))

    def check(self) -> None:
        """Raise InputError with all messages in order of rows, if there are any."""
        if self._problems:
            ordered = sorted(self._problems, key=lambda problem: problem[0])
            raise input_problems([text for _, text in ordered])


class _ItemColumn:
    """A column in which all rows of an item have the same text, that of each item."""

    def __init__(self, *texts: str) -> None:
        """Take the text of the first item, if there is one."""
        self._numbering = _make_numbering(*texts)
        self._of_items: list[int] = [*range(len(texts))]

    def pop(self) -> str:
        """Remove the last item, and return its text."""
        return [*self._numbering][self._of_items.pop()]

    def texts(self) -> tuple[str, ...]:
        """Return the text of each item."""
        texts = [*self._numbering]
        return tuple([texts[number] for number in self._of_items])

    def add(self, column: str, cells: Cells, item: NDArray[np.int32]) -> Flags:
        """Add the texts of items that are new in these cells.

        item (n,): numbers of the rows' items, new ones the next numbers. Returns a mask
        (n,) of rows whose cell is not the first cell of their item.
        """
        text = _number_texts(column, self._numbering, cells)
        place, names = cells.unique_texts("item")
        items = np.empty(len(names), np.int32)
        items[place] = item
        first = np.empty(len(names), np.int32)
        # Of several rows of an item the first is written last, and stays.
        first[place[::-1]] = text[::-1]
        is_new = items >= len(self._of_items)
        self._of_items += first[is_new].tolist()
        known = [self._of_items[number] for number in items.tolist()]
        differ: Flags = text != np.array(known, np.int32)[place]
        return differ


def _make_numbering(*texts: str) -> defaultdict[str, int]:
    """Return a dict that numbers texts from 0: these `texts`, then each new key."""
    return defaultdict(count(len(texts)).__next__, zip(texts, count()))


def _number_texts(
    column: str, numbering: defaultdict[str, int], cells: Cells
) -> NDArray[np.int32]:
    """Return the number (n,) of each row's text in a column; new texts get the next."""
    texts_of_rows, texts = cells.unique_texts(column)
    numbers = np.fromiter(map(numbering.__getitem__, texts), np.int32, len(texts))
    return numbers[texts_of_rows]


class Spool:
    """Images of a large table in a temporary file, in parts; one part is cached."""

    def __init__(self) -> None:
        self._names: Sequence[str] = ()
        self._file = TemporaryFile()  # noqa: SIM115 gone with the source
        self._starts, self._offsets = [0], list[int]()
        self.hashes: list[NDArray[np.int64]] = []
        self._last_frame: dict[str, int] = {}
        self.in_order = True
        self._part = lru_cache(1)(self._read_part)

    def __len__(self) -> int:
        return self._starts[-1]

    def append(self, images: Items) -> None:
        """Append images to the temporary file, as its next part."""
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
        """Return the images `rows`, counted over all parts, as one record."""
        first = bisect_right(self._starts, rows.start) - 1
        end = max(bisect_left(self._starts, rows.stop), first + 1)
        parts = []
        for number, start in enumerate(self._starts[first:end], first):
            inner = slice(max(rows.start - start, 0), rows.stop - start)
            parts.append(self._part(number).take(inner))
        return concatenate(parts)

    def _read_part(self, number: int) -> Items:
        """Read the images of a part; landmarks of later parts alone are unseen."""
        self._file.seek(self._offsets[number])
        images: Items = pickle.load(self._file)
        return arrange(images, self._names)


@contextmanager
def csv_output(target: Path) -> Iterator[CsvWriter]:
    """Give a CsvWriter to `target`, which appears on a clean exit; `-` is stdout."""
    with ExitStack() as stack:
        file: IO[bytes]
        if is_stream(target):
            if sys.stdout is None:
                raise input_error(
                    "standard output", "is closed", "name a file to write instead"
                )
            file, place, errnos = (
                sys.stdout.buffer,
                Path("standard output"),
                OF_THE_DISK,
            )
        else:
            path = stack.enter_context(atomic_path(target))
            file, place, errnos = stack.enter_context(path.open("wb")), target, None

        def write(data: bytes | memoryview) -> None:
            """Write bytes to the file at once; InputError where that fails."""
            with storage_errors(place, errnos):
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
        numbers, texts = _csv_columns(record)
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
            self._write(_csv_lines(record.take(slice(start, start + items))))


def _csv_columns(record: Items) -> tuple[dict[str, Floats], dict[str, Sequence[str]]]:
    """Return a record's CSV columns of numbers (n, p) and of texts (n,), by name.

    Those are of each landmark and of each item, beside `item` and `landmark`.
    """
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


def _csv_lines(record: Items) -> memoryview:
    """Format a record as rows of CSV, a row for each landmark, without a header."""
    n = len(record)
    p = len(record.landmark_names)
    numbers, texts = _csv_columns(record)
    item, landmark = np.divmod(np.arange(n * p), max(p, 1))
    text_indices = [
        item,
        landmark + n,
        *(item + n * k + p for k in range(1, len(texts) + 1)),
    ]
    values = np.stack([*numbers.values()], axis=-1).reshape(n * p, len(numbers))
    shown = chain(record.items, record.landmark_names, *texts.values())
    text_of_cell = np.column_stack(text_indices)
    return format_rows([*map(csv_cell, shown)], text_of_cell, values, leading=2)
