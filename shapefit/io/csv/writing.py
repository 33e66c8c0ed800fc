"""Write records as tidy CSV, chunk by chunk."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import chain
from pathlib import Path

import numpy as np
import orjson

from shapefit.arrays import Floats
from shapefit.errors import input_error
from shapefit.io.csv.tables import DEVIATIONS
from shapefit.io.layout import Format
from shapefit.io.options import Summary
from shapefit.io.records import LandmarkSet, Records, ResultSet
from shapefit.io.sources import is_stream
from shapefit.io.whole.atomic import atomic_file, storage_errors, write_all
from shapefit.io.writing import NOTHING_APPENDED
from shapefit.lifting.verdict import TRUSTED

Write = Callable[[bytes], None]

BLOCK_ROWS = 4096
"""Rows that are written at a time; larger blocks leave the processor's cache and take longer."""

DECIMALS, WIDE = 2, 100
"""Of pixels, where the landmarks of an image spread over so many of them."""

WHOLE = 2.0**52
"""From which on all numbers of 64 bits are whole."""

Y_UP = "y points up, which CSV cannot say: read the file with `--set y_axis=up`"

_IN_QUOTES = re.compile('[",\\r\\n]')


class CsvWriter:
    """Appends records as rows `item,landmark,x,y[,z][,confidence][,sd_x,sd_y,sd_z][,sequence]`.

    Results with readings also have a column `modes`, those with a verdict a column `trusted`.

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
def csv_output(target: Path, form: Format) -> Iterator[CsvWriter]:
    """Give a writer to standard output, for `-`, or to a file that appears on a clean exit."""
    if is_stream(target):
        if sys.stdout is None:
            raise input_error("standard output", "is closed", "name a file to write instead")
        with storage_errors(Path("standard output")):
            yield from _checked(CsvWriter(_write_to_stdout))
        return
    with atomic_file(target) as file:
        yield from _checked(CsvWriter(lambda data: write_all(file, data)))


def _checked(writer: CsvWriter) -> Iterator[CsvWriter]:
    yield writer
    if not writer.begun:
        raise ValueError(NOTHING_APPENDED)


def _write_to_stdout(data: bytes) -> None:
    sys.stdout.buffer.write(data)
    sys.stdout.buffer.flush()


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


def _rows(record: Records, part: slice, decimals: int | None = None) -> bytes:
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
    landmarks = [b",%b," % _cell(name) for name in record.landmark_names]
    names = [item + landmark for item in map(_cell, record.items[part]) for landmark in landmarks]
    columns = _of_items(record, part).values()
    cells = zip(*columns, strict=True) if columns else [()] * n
    ends = [b"".join(b",%b" % _cell(cell) for cell in row) + b"\n" for row in cells]
    ends = [end for end in ends for _ in range(p)]
    return b"".join(chain.from_iterable(zip(names, _texts(numbers), ends, strict=True)))


def _of_items(record: Records, part: slice) -> dict[str, list[str]]:
    """Return the columns that are the same in all rows of an item, with a cell per item."""
    columns: dict[str, list[str]] = {}
    if record.sequences is not None:
        columns["sequence"] = list(record.sequences[part])
    if isinstance(record, ResultSet):
        if record.modes is not None:
            columns["modes"] = [str(count) for count in record.modes[part].tolist()]
        if TRUSTED in record.extras:
            columns[TRUSTED] = [
                "true" if each else "false" for each in record.extras[TRUSTED][part]
            ]
    return columns


def _texts(rows: Floats) -> list[bytes]:
    """Return each row of numbers with commas between them, nothing for nan."""
    if not rows.size:
        return [b""] * len(rows)
    text = orjson.dumps(np.ascontiguousarray(rows), option=orjson.OPT_SERIALIZE_NUMPY)
    return text[2:-2].replace(b"null", b"").split(b"],[")


def _cell(text: str) -> bytes:
    """Return a text as a cell, in quotes where it needs them."""
    if text and not _IN_QUOTES.search(text):
        return text.encode()
    return '"{}"'.format(text.replace('"', '""')).encode()
