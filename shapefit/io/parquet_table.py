"""Parquet: the tidy table of CSV with typed columns; the unit and axes stand in its metadata."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from shapefit.errors import input_error
from shapefit.io.atomic import atomic_path, storage_errors
from shapefit.io.csv_writer import deviations_of, item_columns
from shapefit.io.layout import UNKNOWN_UNIT, Layout
from shapefit.io.options import Summary
from shapefit.io.records import Records
from shapefit.io.tidy_table import Block, check_columns, read_tidy
from shapefit.io.writing import NOTHING_APPENDED

try:
    import pyarrow
    import pyarrow.parquet
except ImportError as error:
    found = "these files need the library pyarrow, which is not installed"
    raise input_error("Parquet", found, "run `pip install pyarrow`") from error

FAULTS = (pyarrow.ArrowException, OSError, RuntimeError, KeyError, TypeError, ValueError)
DAMAGED = "the file may be cut off or damaged: copy or make it again"
ROWS = 1 << 16
"""Rows of a table that are decoded, and items that are written, at a time."""
TEXTS = ("item", "landmark", "sequence")
SAID = ("unit", "y_axis", "frame_rate")


class ParquetRows:
    """The rows of an open file as blocks of columns; `line` of a message is a row, from 1."""

    def __init__(self, path: Path, required: Sequence[str], optional: Sequence[str]) -> None:
        self.name = str(path)
        with _damage(path):
            self._file = pyarrow.parquet.ParquetFile(
                pyarrow.OSFile(os.fspath(path)), page_checksum_verification=True
            )
            self.columns = list(self._file.schema_arrow.names)
            said = self._file.schema_arrow.metadata or {}
        if b"landmark_names" in said or ("item" in self.columns) > ("landmark" in self.columns):
            fix = "convert it to HDF5 with the version that wrote it (it has a row per landmark)"
            raise input_error(path, "is a table with one item a row", fix)
        check_columns(self.columns, required, optional, self.name)

    def place(self, row: int) -> str:
        """Name a row in messages."""
        return f"{self.name}: row {row}"

    def blocks(self) -> Iterator[Block]:
        """Read the rows in order."""
        start = 1
        with _damage(Path(self.name)):
            for batch in self._file.iter_batches(ROWS, use_threads=False):
                columns = dict(zip(self.columns, batch.columns, strict=True))
                texts: dict[str, Sequence[str]] = {
                    name: _texts(columns[name]) for name in TEXTS if name in columns
                }
                numbers = {
                    name: _numbers(values, f"{self.name}: column {name}")
                    for name, values in columns.items()
                    if name not in texts and name not in ("modes", "trusted")
                }
                lines = np.arange(start, start + len(batch))
                start += len(batch)
                if len(batch):
                    yield Block(texts, lines, numbers)


def read_landmarks(path: Path) -> Records:
    """Read `item, landmark, x, y[, confidence][, sequence]`; null or nan is unseen."""
    return _read(path, "landmarks")


def read_shapes(path: Path, *, gaps: bool = False) -> Records:
    """Read `item, landmark, x, y, z[, sequence]`, as from CSV."""
    return _read(path, "shapes", gaps=gaps)


def read_result(path: Path) -> Records:
    """Read `item, landmark, x, y, z[, sequence]`, as from CSV."""
    return _read(path, "result")


def _read(path: Path, kind: str, **how: bool) -> Records:
    records: Records = read_tidy(path, kind, ParquetRows, **how)
    said: dict[str, Any] = _said(path)
    if "frame_rate" in said:
        said["frame_rate"] = float(said["frame_rate"])
    if kind == "shapes":
        said.pop("y_axis", None)
    return records.replaced(**said)


def _said(path: Path) -> dict[str, str]:
    """Return what the metadata say of unit, direction and frame rate."""
    with _damage(path):
        said = pyarrow.parquet.read_schema(str(path)).metadata or {}
    return {key: said[key.encode()].decode() for key in SAID if key.encode() in said}


def parquet_kind(path: Path) -> str:
    """Return what a table holds: landmarks, or shapes where it has the column z."""
    with _damage(path):
        names = pyarrow.parquet.read_schema(str(path)).names
    return "shapes" if "z" in names else "landmarks"


@contextmanager
def parquet_output(target: Path, form: Layout) -> Iterator[ParquetWriter]:
    """Give a writer to a file that appears on a clean exit."""
    with atomic_path(target) as path, storage_errors(target, None):
        writer = ParquetWriter(path)
        try:
            yield writer
        finally:
            writer.close()
        if not writer.begun:
            raise ValueError(NOTHING_APPENDED)


class ParquetWriter:
    """Appends records as rows with the columns that CSV has, numbers as they are."""

    def __init__(self, path: Path) -> None:
        self.attributes: dict[str, str | float | int] = {}
        self.summary = Summary()
        self._path = path
        self._writer: Any = None

    @property
    def begun(self) -> bool:
        """Whether a record was appended."""
        return self._writer is not None

    def append(self, record: Records) -> None:
        """Write one row for each landmark of each item.

        Raises ValueError where the columns are not those of the first record.
        """
        if not self.begun:
            schema = _table(record.take(slice(0))).schema
            self._writer = pyarrow.parquet.ParquetWriter(
                str(self._path), schema, compression="zstd", write_page_checksum=True
            )
        for start in range(0, len(record), ROWS):
            table = _table(record.take(slice(start, start + ROWS)))
            if table.schema != self._writer.schema:
                raise ValueError("the columns of this record are not those of the first")
            self._writer.write_table(table)

    def close(self) -> None:
        """Write what ends the file."""
        if self._writer is not None:
            self._writer.close()


def _table(record: Records) -> Any:
    """Return records as a table of arrow."""
    points = record.points
    n, d, p = points.shape
    rows = np.arange(n * p)
    columns: dict[str, Any] = {
        "item": _coded(record.items, rows // max(p, 1)),
        "landmark": _coded(record.landmark_names, rows % max(p, 1)),
    }
    for axis in range(d):
        columns["xyz"[axis]] = points[:, axis].reshape(-1)
    confidence = getattr(record, "confidence", None)
    if confidence is not None:
        columns["confidence"] = confidence.reshape(-1)
    columns |= deviations_of(record)
    of_items = item_columns(record)
    if "sequence" in of_items:
        columns["sequence"] = _coded(of_items.pop("sequence"), rows // max(p, 1))
    columns |= {name: np.repeat(values, p) for name, values in of_items.items()}
    said = {"unit": record.unit} if record.unit != UNKNOWN_UNIT else {}
    said |= {"y_axis": record.y_axis} if record.y_axis else {}
    said |= {} if record.frame_rate is None else {"frame_rate": repr(float(record.frame_rate))}
    return pyarrow.table(columns).replace_schema_metadata(said)


def _coded(texts: Sequence[str], rows: Any) -> Any:
    codes = pyarrow.array(rows.astype(np.int32))
    return pyarrow.DictionaryArray.from_arrays(codes, pyarrow.array(list(texts), pyarrow.string()))


def _texts(column: Any) -> list[str]:
    """Return a column of texts; null is an empty one."""
    if pyarrow.types.is_dictionary(column.type):
        names = [name or "" for name in column.dictionary.cast(pyarrow.string()).to_pylist()]
        codes = column.indices.fill_null(len(names)).to_numpy(zero_copy_only=False)
        return np.array([*names, ""], object)[codes].tolist()
    return [text or "" for text in column.cast(pyarrow.string()).to_pylist()]


def _numbers(column: Any, place: str) -> Any:
    """Return a column of numbers; null is nan. Raises InputError for other types."""
    kind = column.type
    if not (pyarrow.types.is_floating(kind) or pyarrow.types.is_integer(kind)):
        raise input_error(place, f"holds values of type {kind}", "store numbers")
    return column.cast(pyarrow.float64(), safe=False).to_numpy(zero_copy_only=False)


@contextmanager
def _damage(path: Path) -> Iterator[None]:
    """Turn what pyarrow raises for a truncated or damaged file into an InputError."""
    try:
        yield
    except FAULTS as error:
        reason = str(error).partition("\n")[0] or type(error).__name__
        raise input_error(path, f"cannot be read ({reason})", DAMAGED) from error
