"""Write records, and errors image by image, as tidy CSV, chunk by chunk."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from shapefit import core
from shapefit.arrays import Floats
from shapefit.errors import input_error
from shapefit.io.atomic import output_bytes, storage_errors
from shapefit.io.inputs import is_stream
from shapefit.io.layout import Layout
from shapefit.io.options import Summary
from shapefit.io.records import LandmarkSet, Records, ResultSet
from shapefit.io.tidy_table import DEVIATIONS
from shapefit.io.writing import NOTHING_APPENDED
from shapefit.lifting.verdict import TRUSTED

if TYPE_CHECKING:
    from shapefit.evaluation.summaries import ImageErrors

Write = Callable[[bytes | memoryview], None]

BLOCK_ROWS = 4096
"""Rows that are written at a time; larger blocks leave the processor's cache and take longer."""

DECIMALS, WIDE = 2, 100
"""Of pixels, where the landmarks of an image spread over so many of them."""

WHOLE = 2.0**52
"""From which on all numbers of 64 bits are whole."""

NUMBER = 26
"""Bytes of a number with the comma behind it, at most."""

Y_UP = "y points up, which CSV cannot say: read the file with `--set y_axis=up`"

IN_QUOTES = ('"', ",", "\r", "\n")
"""A cell with one of these is in quotes."""

PER_IMAGE = ("method", "sequence", "item", "metric", "error", "unit")
"""Columns of per_image.csv."""


class CsvWriter:
    """Appends records as rows `item,landmark,x,y[,z][,confidence][,sd_x,sd_y,sd_z][,sequence]`.

    Results with a verdict also have a column `trusted`.

    NaN becomes an empty cell; numbers have the fewest digits that read back to the same float, but
    pixels two decimals, where landmarks spread over WIDE of them or more.
    The header is written with the first record. CSV has no place for `attributes`.
    """

    def __init__(self, write: Write) -> None:
        self.attributes: dict[str, str | float | int] = {}
        self.summary = Summary()
        self._write = write
        self._columns: list[str] | None = None
        self._in_pixels = False

    @property
    def begun(self) -> bool:
        """Whether a record was appended."""
        return self._columns is not None

    def append(self, record: Records) -> None:
        """Write one row for each landmark of each item.

        Raises ValueError where the columns are not those of the first record.
        """
        columns = _columns(record)
        if not self.begun:
            self._write(f"{','.join(columns)}\n".encode())
            self._in_pixels = _is_wide(record)
        elif columns != self._columns:
            raise ValueError("the columns of this record are not those of the first")
        self._columns = columns
        if getattr(record, "y_axis", None) == "up":
            self.summary = Summary(warnings=(Y_UP,))
        for part in _parts(len(record), len(record.landmark_names)):
            self._write(_rows(record, part, DECIMALS if self._in_pixels else None))


@contextmanager
def csv_output(target: Path, form: Layout) -> Iterator[CsvWriter]:
    """Give a writer to standard output, for `-`, or to a file that appears on a clean exit."""
    with _standard_output() if is_stream(target) else output_bytes(target) as write:
        writer = CsvWriter(write)
        yield writer
        if not writer.begun:
            raise ValueError(NOTHING_APPENDED)


@contextmanager
def _standard_output() -> Iterator[Write]:
    if sys.stdout is None:
        raise input_error("standard output", "is closed", "name a file to write instead")

    def write(data: bytes | memoryview) -> None:
        sys.stdout.buffer.write(data)
        sys.stdout.buffer.flush()

    with storage_errors(Path("standard output")):
        yield write


def _columns(record: Records) -> list[str]:
    columns = ["item", "landmark", *"xyz"[: record.points.shape[1]]]
    for name, own in (("confidence", ("confidence",)), ("shape_sd", DEVIATIONS)):
        columns += own if getattr(record, name, None) is not None else ()
    return [*columns, *_of_items(record, slice(0))]


def _parts(n: int, p: int) -> Iterator[slice]:
    """Cut n items of p landmarks where BLOCK_ROWS rows are reached."""
    items = max(1, BLOCK_ROWS // max(1, p))
    return (slice(start, start + items) for start in range(0, n, items))


def _is_wide(record: Records) -> bool:
    """Whether these are pixels, of which a hundredth does not count."""
    if not isinstance(record, LandmarkSet) or record.unit != "px" or not record.landmarks.size:
        return False
    known = np.isfinite(record.landmarks)
    least = np.where(known, record.landmarks, np.inf).min(axis=2)
    most = np.where(known, record.landmarks, -np.inf).max(axis=2)
    return bool(np.median((most - least).max(axis=1)) >= WIDE)


def _rows(record: Records, part: slice, decimals: int | None = None) -> memoryview:
    """Return the lines of some of the items, with so many decimals of the points."""
    points = record.points[part]
    if decimals is not None:
        is_whole = np.abs(points) >= WHOLE  # times a hundred it may be beyond all numbers
        points = np.where(is_whole, points, np.round(np.where(is_whole, 0, points), decimals))
    n, dimensions, p = points.shape
    numbers = points.swapaxes(1, 2).reshape(n * p, dimensions)
    confidence, deviations = (getattr(record, name, None) for name in ("confidence", "shape_sd"))
    if confidence is not None:
        numbers = np.column_stack([numbers, confidence[part].reshape(n * p)])
    if deviations is not None:
        numbers = np.column_stack([numbers, deviations[part].swapaxes(1, 2).reshape(n * p, 3)])
    item, landmark = np.divmod(np.arange(n * p), max(p, 1))
    names = [cells_of(record.items[part], item), cells_of(record.landmark_names, landmark)]
    return rows_of(names, numbers, [cells_of(c, item) for c in _of_items(record, part).values()])


def _of_items(record: Records, part: slice) -> dict[str, list[str]]:
    """Return the columns that are the same in all rows of an item, with a cell per item."""
    words = {True: "true", False: "false"}
    return {
        name: [words.get(value, value) if name == TRUSTED else str(value) for value in values]
        for name, values in item_columns(record, part).items()
    }


def item_columns(record: Records, part: slice = slice(None)) -> dict[str, Any]:
    """Return the columns that are the same in all rows of an item: sequence, trusted."""
    columns: dict[str, Any] = {}
    if record.sequences is not None:
        columns["sequence"] = record.sequences[part]
    if isinstance(record, ResultSet):
        trusted = record.per_item(TRUSTED)
        if trusted is not None:
            columns[TRUSTED] = np.asarray(trusted[part], bool)
    return columns


def deviations_of(record: Records) -> dict[str, Floats]:
    """Return standard deviations of results as columns, one row a landmark of an item."""
    sd = getattr(record, "shape_sd", None)
    return {} if sd is None else {n: sd[:, axis].reshape(-1) for axis, n in enumerate(DEVIATIONS)}


class Cells(NamedTuple):
    """A column of texts: the letters of all, where each starts and the last ends, that of each row.

    starts (t + 1,) of t texts, rows (n,) the number of the text of each row.
    """

    letters: bytes
    starts: NDArray[np.int64]
    rows: NDArray[np.int64]


def cells_of(texts: Sequence[str], rows: NDArray[np.int64], empty: str = '""') -> Cells:
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
    room = int(np.diff(starts)[texts].sum()) + texts.size + NUMBER * numbers.size
    rows = np.empty(room // 8 + 1, np.uint64)
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


def per_image_header() -> bytes:
    """Return the first line of per_image.csv."""
    return f"{','.join(PER_IMAGE)}\n".encode()


def per_image_rows(errors: ImageErrors) -> Iterator[memoryview]:
    """Yield the lines of per_image.csv of a method in a metric; a failed image's error is empty."""
    names = cells_of(errors.sequences.names, np.arange(0), empty="")
    words = (errors.method, errors.metric, errors.unit)
    for start in range(0, len(errors.values), BLOCK_ROWS):
        part = slice(start, start + BLOCK_ROWS)
        values, items = errors.values[part], errors.items[part]
        none = np.zeros(len(values), np.int64)
        method, metric, unit = (cells_of([word], none, empty="") for word in words)
        sequence = names._replace(rows=errors.sequences.codes[part].astype(np.int64))
        item = cells_of(items, np.arange(len(items)), empty="")
        yield rows_of([method, sequence, item, metric], values[:, None], [unit], as_python=True)
