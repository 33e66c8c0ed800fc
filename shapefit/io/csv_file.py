"""The tidy table as CSV: text to cells and numbers, and back.

Text is split at commas while it holds no quote; from the first quote on, and for lines that do not
fit, the csv module reads it.
"""

from __future__ import annotations

import csv
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from io import StringIO
from itertools import chain
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from shapefit import core
from shapefit.arrays import Floats, Integers
from shapefit.errors import InputError, input_error
from shapefit.io.atomic import atomic_path, storage_errors
from shapefit.io.checks import input_problems
from shapefit.io.inputs import (
    BLOCK_BYTES,
    BYTE_ORDER_MARK,
    GZIP_SIGNATURE,
    begins_with,
    is_stream,
    read_text_blocks,
    source_name,
)
from shapefit.io.options import RecordWriter, Summary
from shapefit.io.records import LandmarkSet, Records, ResultSet
from shapefit.io.tidy_table import Block, Rows, check_columns, read_tidy, table_columns

Write = Callable[[bytes | memoryview], object]

ROWS = 1 << 12
"""Rows that the csv module reads, and that are written, at a time: more leave the cache of the
processor, and take longer."""

QUOTES = "put cells with commas or quotes in double quotes, and double the quotes in them"
SAVE = "save it as CSV in UTF-8"


def read_csv(
    path: Path, kind: str, *, gaps: bool = False, first: int | None = None
) -> tuple[Any, tuple[str, ...], int | None]:
    """Read `item,landmark,x,y[,confidence]` or `item,landmark,x,y,z`, each with `[,sequence]`.

    Return records, or a Spool of many landmarks, warnings, and an estimate of the number of items
    where only some `first` landmarks were read. An empty or nan coordinate is unknown; shapes must
    have every landmark of every item unless `gaps`.
    """
    header, blocks = _open(path, kind)
    opened = iter([blocks])
    once = is_stream(path) or not path.is_file()
    rows = Rows(source_name(path), header, lambda: next(opened, None) or _open(path, kind)[1], once)
    records, notes, last = read_tidy(rows, kind, gaps=gaps, first=first)
    return records, notes, last and round(len(records) * _count_lines(path) / last)


def _count_lines(path: Path) -> float:
    """Return about how many lines a text has, by the length of those in nine places."""
    if begins_with(path, GZIP_SIGNATURE):
        return sum(block.count(b"\n") for block in read_text_blocks(path))
    size, sample = path.stat().st_size, b""
    with path.open("rb") as file:
        for place in np.linspace(0, max(size - BLOCK_BYTES, 0), 9).astype(int).tolist():
            file.seek(place)
            sample += file.read(BLOCK_BYTES)
    return size * sample.count(b"\n") / len(sample)


def csv_kind(path: Path) -> str:
    """Return what a table holds: landmarks, or shapes where it has the column z."""
    _, text = next(read_texts(path))
    cells = text.partition("\n")[0].split(",")
    return "shapes" if "z" in (cell.strip(' "\t\r') for cell in cells) else "landmarks"


def _open(path: Path, kind: str) -> tuple[Sequence[str], Iterator[Block]]:
    """Open a table of a kind: its columns, and the lines and cells of rows that are not empty.

    Where the header has spaces around its names, so have the cells, and they are taken away. Raises
    InputError for text that is not UTF-8, for other columns than those of the kind, for cells that
    are no CSV and for rows with too few or too many cells.
    """
    name, texts = source_name(path), read_texts(path)
    _, text = next(texts)
    first, _, rest = text.partition("\n")
    try:
        header = next(csv.reader([first]), [])
    except csv.Error as error:
        raise _bad_line(f"{name}:1", error) from error
    columns = [column.strip() for column in header]
    required, optional = table_columns(kind)
    if not {*required, *optional} & set(columns):
        raise _header_error(first.strip(), columns, required, f"{name}:1")
    check_columns(columns, kind, f"{name}:1")

    def blocks() -> Iterator[Block]:
        for lines, cells in _parts(chain([(2, rest)] if rest else [], texts), len(columns), name):
            if columns != header:
                cells = [[cell.strip() for cell in column] for column in cells]
            yield lines, dict(zip(columns, cells, strict=True))

    return columns, blocks()


def _parts(
    texts: Iterator[tuple[int, str]], width: int, name: str
) -> Iterator[tuple[Integers, Sequence[Sequence[str]]]]:
    """Yield the lines and the columns of some rows after others."""
    for line, text in texts:
        columns = split_columns(text, width)
        if columns is not None:
            yield np.arange(line, line + len(columns[0])), columns
            continue
        following = (text for _, text in texts) if '"' in text else ()
        rows = read_rows(chain([text], following), line, name)
        while part := [row for row, _ in zip(rows, range(ROWS), strict=False)]:
            if wrong := [(at, len(row)) for at, row in part if len(row) != width]:
                end = f"cells for {width} columns; write one cell per column"
                raise input_problems([f"{name}:{at}: has {n} {end}" for at, n in wrong])
            lines = np.array([at for at, _ in part])
            yield lines, list(zip(*(row for _, row in part), strict=True))


def _header_error(
    first: str, columns: Sequence[str], required: Sequence[str], place: str
) -> InputError:
    """Return the error for a header none of whose columns is known."""
    for letter, name in ((";", "semicolons"), ("\t", "tabs")):
        if letter in first and len(columns) == 1:
            fix = "save it with commas between the cells, and with decimal points"
            return input_error(place, f"separates its cells by {name}", fix)
    if "frame_idx" in columns:
        fix = "give the .slp file, or export the analysis HDF5 file of SLEAP"
        return input_error(place, "is one of SLEAP's tables, which are not read", fix)
    fix = f"write the header {','.join(required)}, with commas"
    return input_error(place, f"the header is '{first[:80]}'", fix)


def read_texts(path: Path) -> Iterator[tuple[int, str]]:
    """Yield the text of standard input, a pipe or a file, whole lines and the first one's number.

    Lines that end in CR alone, as on old Macs, get the line ends of today. Raises InputError as
    `read_text_blocks` does, and for text that is not UTF-8.
    """
    name = source_name(path)
    line, rest, old = 1, b"", False
    for number, block in enumerate(chain(read_text_blocks(path), [b""])):
        if number == 0:
            block = block.removeprefix(BYTE_ORDER_MARK)
            old = b"\r" in block and b"\n" not in block
        data = rest + (block.replace(b"\r", b"\n") if old else block)
        end = data.rfind(b"\n") + 1 if block else len(data)  # the last line may have no end
        rest = data[end:]
        if len(rest) > csv.field_size_limit():
            fix = "check the quotes around it, and the ends of lines"
            raise input_error(f"{name}:{line}", "a bad cell (it has no end)", fix)
        if end or (line == 1 and not block):
            try:
                text = data[:end].decode("utf-8")
            except UnicodeDecodeError as error:
                line += data.count(b"\n", 0, error.start)
                raise input_error(f"{name}:{line}", "is not UTF-8 text", SAVE) from error
            refuse_zero_bytes(text, name, line)
            yield line, text
            line += data.count(b"\n", 0, end)


def refuse_zero_bytes(text: str, name: str, line: int) -> None:
    """Raise InputError for the line of a zero byte in a text that begins with this line."""
    if "\0" in text:
        line += text.count("\n", 0, text.index("\0"))
        raise input_error(f"{name}:{line}", "is not text (a zero byte)", SAVE)


def split_columns(text: str, width: int) -> list[list[str]] | None:
    """Return the columns of lines that all have `width` cells, none of them quoted.

    None where it is not so plain; `read_rows` takes every text, and finds the same cells.
    """
    if "\r" in text:
        text = text.replace("\r\n", "\n")
    if '"' in text or "\r" in text:
        return None
    text = text.removesuffix("\n")
    letters = np.frombuffer(text.encode() + b"\n", np.uint8)
    ends, commas = np.flatnonzero(letters == ord("\n")), np.flatnonzero(letters == ord(","))
    if len(commas) != len(ends) * (width - 1):
        return None
    between = commas.reshape(len(ends), width - 1)
    if (between[:, -1] > ends).any() or (between[1:, 0] < ends[:-1]).any():
        return None
    cells = text.replace("\n", ",").split(",")
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
    """Return the error for what the csv module found at a place."""
    if "unexpected end" in str(error):
        return input_error(place, "a quote is never closed", QUOTES)
    return input_error(place, f"a bad cell ({error})", f"check the quotes around it: {QUOTES}")


# Writing.

DECIMALS, WIDE = 2, 100
"""Of pixels, where the landmarks of an image spread over so many of them."""

WHOLE = 2.0**52
"""From which on all numbers of 64 bits are whole."""

NUMBER = 26
"""Bytes of a number with the comma behind it, at most."""

Y_UP = "y points up, which CSV cannot say: read the file with `y_axis=up`"

IN_QUOTES = ('"', ",", "\r", "\n")
"""A cell with one of these is in quotes."""


@contextmanager
def csv_output(target: Path) -> Iterator[CsvWriter]:
    """Give a writer to standard output, for `-`, or to a file that appears on a clean exit."""
    if is_stream(target):
        with _standard_output() as write:
            writer = CsvWriter(write)
            yield writer
            writer.check_begun()
        return
    with atomic_path(target) as path, path.open("wb") as file:
        writer = CsvWriter(file.write)
        yield writer
        writer.check_begun()


@contextmanager
def _standard_output() -> Iterator[Write]:
    if sys.stdout is None:
        raise input_error("standard output", "is closed", "name a file to write instead")

    def write(data: bytes | memoryview) -> None:
        sys.stdout.buffer.write(data)
        sys.stdout.buffer.flush()

    with storage_errors(Path("standard output")):
        yield write


class CsvWriter(RecordWriter[Records]):
    """Appends records as rows `item,landmark,x,y[,z][,confidence][,sd_x,sd_y,sd_z][,sequence]`.

    Results with a verdict also have a column `trusted`. NaN becomes an empty cell; numbers have the
    fewest digits that read back to the same float, but pixels two decimals, where landmarks spread
    over WIDE of them or more. CSV has no place for `attributes`.
    """

    def __init__(self, write: Write) -> None:
        super().__init__()
        self._write = write
        self._header = b""
        self._in_pixels = False

    def append(self, record: Records) -> None:
        """Write one row for each landmark of each item.

        Raises ValueError where the columns are not those of the first record.
        """
        numbers, texts = _columns(record, slice(0))
        header = ",".join(["item", "landmark", *numbers, *texts]).encode()
        if not self.begun:
            self._write(header + b"\n")
            self._header, self._in_pixels = header, _is_wide(record)
        elif header != self._header:
            raise ValueError("the columns of this record are not those of the first")
        self.begun = True
        if record.y_axis == "up":
            self.summary = Summary(warnings=(Y_UP,))
        items = max(1, ROWS // max(1, len(record.landmark_names)))
        for start in range(0, len(record), items):
            self._write(_lines(record, slice(start, start + items), self._in_pixels))


def _is_wide(record: Records) -> bool:
    """Whether these are pixels, of which a hundredth does not count."""
    if not isinstance(record, LandmarkSet) or record.unit != "px" or not record.landmarks.size:
        return False
    known = np.isfinite(record.landmarks)
    least = np.where(known, record.landmarks, np.inf).min(axis=2)
    most = np.where(known, record.landmarks, -np.inf).max(axis=2)
    return bool(np.median((most - least).max(axis=1)) >= WIDE)


def _columns(record: Records, part: slice) -> tuple[dict[str, Floats], dict[str, Sequence[str]]]:
    """Return the columns of some items beside `item` and `landmark`, in their order in a file.

    First the numbers (n, p) each, then what is the same in all rows of an item, (n,) texts each.
    """
    points = {"xyz"[axis]: values for axis, values in enumerate(record.points.swapaxes(0, 1))}
    numbers = {name: values[part] for name, values in points.items()}
    texts: dict[str, Sequence[str]] = {}
    if isinstance(record, LandmarkSet) and record.confidence is not None:
        numbers["confidence"] = record.confidence[part]
    if record.sequences is not None:
        texts["sequence"] = record.sequences[part]
    if isinstance(record, ResultSet):
        if (sd := record.shape_sd) is not None:
            numbers |= {f"sd_{'xyz'[axis]}": sd[part, axis] for axis in range(3)}
        if (trusted := record.trusted) is not None:
            texts["trusted"] = ["true" if value else "false" for value in trusted[part].tolist()]
    return numbers, texts


def _lines(record: Records, part: slice, in_pixels: bool) -> memoryview:
    """Return the lines of some of the items."""
    names, items = record.landmark_names, record.items[part]
    columns, texts = _columns(record, part)
    numbers = np.stack([*columns.values()], axis=-1).reshape(-1, len(columns))
    if in_pixels:
        points = numbers[:, : record.points.shape[1]]
        some = np.abs(points) < WHOLE
        points[some] = np.round(points[some], DECIMALS)
    item, landmark = np.divmod(np.arange(len(items) * len(names)), max(len(names), 1))
    before = [cells_of(items, item), cells_of(names, landmark)]
    return rows_of(before, numbers, [cells_of(values, item) for values in texts.values()])


class Cells(NamedTuple):
    """A column of texts: the letters of all, where each starts and the last ends, that of each row.

    starts (t + 1,) of t texts, rows (n,) the number of the text of each row.
    """

    letters: bytes
    starts: Integers
    rows: Integers


def cells_of(texts: Sequence[str], rows: Integers, empty: str = '""') -> Cells:
    """Return a column of texts, in quotes where they need them; `empty` stands for no letters."""
    whole = "".join(texts)
    if any(mark in whole for mark in IN_QUOTES):
        texts = [_quoted(t) if any(mark in t for mark in IN_QUOTES) else t for t in texts]
    encoded = [(text or empty).encode() for text in texts]
    return Cells(b"".join(encoded), np.cumsum([0, *map(len, encoded)]), rows)


def _quoted(text: str) -> str:
    return '"{}"'.format(text.replace('"', '""'))


def rows_of(
    before: Sequence[Cells], numbers: Floats, after: Sequence[Cells], *, as_python: bool = False
) -> memoryview:
    """Return rows of texts, numbers (n, d) and texts, with the fewest digits that read back.

    nan is an empty cell. Exponents are those of JSON, or `as_python`, whose `repr` has them sooner.
    """
    columns = [*before, *after]
    letters = b"".join(column.letters for column in columns)
    ends = np.cumsum([0, *(len(column.letters) for column in columns)])
    firsts = np.cumsum([0, *(len(column.starts) - 1 for column in columns)])
    own = [c.starts[:-1] + end for c, end in zip(columns, ends[:-1], strict=True)]
    starts = np.concatenate([*own, ends[-1:]])
    texts = np.column_stack([c.rows + first for c, first in zip(columns, firsts[:-1], strict=True)])
    capacity = int(np.diff(starts)[texts].sum()) + texts.size + NUMBER * numbers.size
    rows = np.empty(capacity // 8 + 1, np.uint64)
    size = core.write_csv_rows(
        letters=np.frombuffer(letters.ljust(len(letters) // 8 * 8 + 8), np.uint64),
        starts=starts.astype(np.int64, copy=False),
        texts=texts.astype(np.int64, copy=False),
        numbers=numbers,
        leading=len(before),
        as_python=as_python,
        rows=rows,
    )
    return rows.view(np.uint8)[:size].data
