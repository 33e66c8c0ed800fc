"""Tidy tables as CSV: text to columns of cells, and records to text.

Text is split at commas while it holds no quote; from the first quote on, and for lines that do not
fit, the csv module reads it.
"""

from __future__ import annotations

import csv
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from io import StringIO
from itertools import chain, islice
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from shapefit import core
from shapefit.arrays import Floats, Integers
from shapefit.errors import input_error
from shapefit.io.atomic import OF_THE_DISK, atomic_path, storage_errors
from shapefit.io.checks import input_problems
from shapefit.io.inputs import is_stream, read_text_blocks, source_name
from shapefit.io.options import RecordWriter, Summary
from shapefit.io.records import LandmarkSet, Records, ResultSet

ROWS = 1 << 12
"""Rows that the csv module reads, and that are written, at a time: more leave the cache of the
processor, and take longer."""

QUOTES = "put cells with commas or quotes in double quotes, and double the quotes in them"

Block = tuple[Integers, dict[str, Sequence[str]]]
"""The lines of some rows, and their cells by column."""


def csv_kind(path: Path) -> str:
    """Return what a table holds: landmarks, or shapes where it has the column z."""
    columns, _ = open_table(path)
    return "shapes" if "z" in columns else "landmarks"


def open_table(path: Path) -> tuple[list[str], Iterator[Block]]:
    """Open a file, a pipe or standard input: its columns, and blocks of rows that are not empty.

    Where the header has spaces around its names, so have the cells, and they are taken away. Raises
    InputError for text that is not UTF-8, for cells that are no CSV, for other separators than
    commas, and for rows with too few or too many cells.
    """
    name, texts = source_name(path), _read_texts(path)
    _, text = next(texts)
    first, _, rest = text.partition("\n")
    _, header = next(read_rows([first], 1, name), (1, [""]))
    columns = [column.strip() for column in header]
    for letter, word in ((";", "semicolons"), ("\t", "tabs")):
        if letter in first and len(columns) == 1:
            fix = "save it with commas between the cells, and with decimal points"
            raise input_error(f"{name}:1", f"separates its cells by {word}", fix)

    def blocks() -> Iterator[Block]:
        for lines, cells in _divided(chain([(2, rest)], texts), len(columns), name):
            if columns != header:
                cells = [[cell.strip() for cell in column] for column in cells]
            yield lines, dict(zip(columns, cells, strict=True))

    return columns, blocks()


def _read_texts(path: Path) -> Iterator[tuple[int, str]]:
    """Yield the text of an input, whole lines at a time, and the number of the first.

    Raises InputError as `read_text_blocks` does, and for text that is not UTF-8.
    """
    name, line, rest = source_name(path), 1, b""
    for block in chain(read_text_blocks(path), [b""]):
        data = rest + block
        end = data.rfind(b"\n") + 1 if block else len(data)  # the last line may have no end
        rest = data[end:]
        if len(rest) > csv.field_size_limit():
            fix = "check the quotes around it, and the ends of lines"
            raise input_error(f"{name}:{line}", "a bad cell (it has no end)", fix)
        if end:
            try:
                text = data[:end].decode("utf-8-sig" if line == 1 else "utf-8")
            except UnicodeDecodeError as error:
                line += data.count(b"\n", 0, error.start)
                fix = "save it as CSV in UTF-8"
                raise input_error(f"{name}:{line}", "is not UTF-8 text", fix) from error
            yield line, text
            line += data.count(b"\n", 0, end)


def _divided(
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
        while part := [*islice(rows, ROWS)]:
            if wrong := [(at, len(row)) for at, row in part if len(row) != width]:
                end = f"cells for {width} columns; write one cell per column"
                raise input_problems([f"{name}:{at}: has {n} {end}" for at, n in wrong])
            yield np.array([at for at, _ in part]), [*zip(*(row for _, row in part), strict=True)]


def split_columns(text: str, width: int) -> list[list[str]] | None:
    """Return the columns of lines that all have `width` cells, none of them quoted.

    None where it is not so plain; `read_rows` takes every text, and finds the same cells.
    """
    text = text.replace("\r\n", "\n") if "\r" in text else text
    if '"' in text or "\r" in text:
        return None
    text = text.removesuffix("\n")
    letters = np.frombuffer(text.encode() + b"\n", np.uint8)
    ends, commas = np.flatnonzero(letters == ord("\n")), np.flatnonzero(letters == ord(","))
    if len(commas) != len(ends) * (width - 1):
        return None
    between = commas.reshape(len(ends), width - 1)
    if (between[:, -1:] > ends[:, None]).any() or (between[1:, :1] < ends[:-1, None]).any():
        return None
    cells = text.replace("\n", ",").split(",")
    columns = [cells[column::width] for column in range(width)]
    return None if "" in columns[0] else columns  # there may be an empty row


def read_rows(texts: Iterable[str], line: int, name: str) -> Iterator[tuple[int, list[str]]]:
    """Yield line and cells of each row that is not empty; texts begin with `line`.

    Raises InputError after the last row that can be read, naming the line of the next one.
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
        fault = f"a bad cell ({error})"
        if "unexpected end" in str(error):
            fault = "a quote is never closed"
        raise input_error(f"{name}:{line}", fault, QUOTES) from error


NUMBER = 26
"""Bytes of a number with the comma behind it, at most."""

Y_UP = "y points up, which CSV cannot say: read the file with `y_axis=up`"


@contextmanager
def csv_output(target: Path) -> Iterator[CsvWriter]:
    """Give a writer to standard output, for `-`, or to a file that appears on a clean exit."""
    with ExitStack() as stack:
        file: Any
        if is_stream(target):
            if sys.stdout is None:
                raise input_error("standard output", "is closed", "name a file to write instead")
            file, place, numbers = sys.stdout.buffer, Path("standard output"), OF_THE_DISK
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


class CsvWriter(RecordWriter[Records]):
    """Appends records as rows `item,landmark,x,y[,z][,confidence][,sd_x,sd_y,sd_z][,sequence]`.

    Results with a verdict also have a column `trusted`. NaN becomes an empty cell; numbers have the
    fewest digits that read back to the same float. CSV has no place for `attributes`.
    """

    def __init__(self, write: Callable[[bytes | memoryview], object]) -> None:
        super().__init__()
        self._write = write
        self._header = b""

    def append(self, record: Records) -> None:
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


def _columns(record: Records) -> tuple[dict[str, Floats], dict[str, Sequence[str]]]:
    """Return the columns beside `item` and `landmark`, in their order in a file.

    First the numbers (n, p) each, then what is the same in all rows of an item, (n,) texts each.
    """
    numbers = {"xyz"[axis]: values for axis, values in enumerate(record.points.swapaxes(0, 1))}
    texts: dict[str, Sequence[str]] = {}
    if isinstance(record, LandmarkSet) and record.confidence is not None:
        numbers["confidence"] = record.confidence
    if record.sequences is not None:
        texts["sequence"] = record.sequences
    if isinstance(record, ResultSet):
        if (sd := record.shape_sd) is not None:
            numbers |= {f"sd_{'xyz'[axis]}": sd[:, axis] for axis in range(3)}
        if (trusted := record.trusted) is not None:
            texts["trusted"] = ["true" if value else "false" for value in trusted.tolist()]
    return numbers, texts


def _lines(record: Records) -> memoryview:
    """Return the lines of some items."""
    names, (columns, texts) = record.landmark_names, _columns(record)
    numbers = np.stack([*columns.values()], axis=-1).reshape(-1, len(columns))
    item, landmark = np.divmod(np.arange(len(record) * len(names)), max(len(names), 1))
    before = [cells_of(record.items, item), cells_of(names, landmark)]
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

    def quoted(text: str) -> str:
        needed = any(mark in text for mark in '",\r\n')
        return '"{}"'.format(text.replace('"', '""')) if needed else text

    whole = "".join(texts)
    if any(mark in whole for mark in '",\r\n'):
        texts = [*map(quoted, texts)]
    encoded = [(text or empty).encode() for text in texts]
    return Cells(b"".join(encoded), np.cumsum([0, *map(len, encoded)]), rows)


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
    offsets = [c.starts[:-1] + end for c, end in zip(columns, ends[:-1], strict=True)]
    starts = np.concatenate([*offsets, ends[-1:]])
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
