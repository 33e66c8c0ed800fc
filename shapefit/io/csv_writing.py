"""Write records as tidy CSV, chunk by chunk."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import polars as pl

from shapefit.errors import input_error
from shapefit.io.atomic import atomic_file, storage_errors, write_all
from shapefit.io.layout import NOTHING_APPENDED
from shapefit.io.records import LandmarkSet, ResultSet, ShapeSet
from shapefit.io.sources import is_stream

Write = Callable[[bytes], None]


class CsvWriter:
    """Appends records as rows `item,landmark,x,y[,z][,confidence][,sequence]`.

    NaN becomes an empty cell; numbers have the fewest digits that read back to the same float.
    The header is written with the first record. CSV has no place for `attributes`.
    """

    def __init__(self, write: Write) -> None:
        self.attributes: dict[str, str | float | int] = {}
        self._write = write
        self._columns: list[str] | None = None

    @property
    def begun(self) -> bool:
        """Whether a record was appended."""
        return self._columns is not None

    def append(self, record: ShapeSet | LandmarkSet | ResultSet) -> None:
        """Write one row for each landmark of each item.

        Raises ValueError where the columns are not those of the first record.
        """
        table = _tidy(record)
        first = not self.begun
        if not first and table.columns != self._columns:
            raise ValueError("the columns of this record are not those of the first")
        self._columns = table.columns
        self._write(table.write_csv(include_header=first).encode())


@contextmanager
def csv_output(target: Path) -> Iterator[CsvWriter]:
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


def _tidy(record: ShapeSet | LandmarkSet | ResultSet) -> pl.DataFrame:
    points = record.landmarks if isinstance(record, LandmarkSet) else record.shapes
    n, dimensions, p = points.shape
    of_item = np.repeat(np.arange(n), p)
    columns = {
        "item": pl.Series(record.items, dtype=pl.String).gather(of_item),
        "landmark": pl.Series(record.landmark_names * n, dtype=pl.String),
    }
    rows = points.swapaxes(1, 2).reshape(n * p, dimensions)
    for number, name in enumerate("xyz"[:dimensions]):
        columns[name] = pl.Series(rows[:, number]).fill_nan(None)
    if isinstance(record, LandmarkSet) and record.confidence is not None:
        columns["confidence"] = pl.Series(record.confidence.reshape(n * p))
    if record.sequences is not None:
        columns["sequence"] = pl.Series(record.sequences, dtype=pl.String).gather(of_item)
    return pl.DataFrame(columns)
