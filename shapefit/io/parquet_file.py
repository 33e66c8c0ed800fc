"""The tidy table as Parquet: typed columns; unit, direction and frame rate in its metadata."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from shapefit.errors import input_error
from shapefit.io.atomic import atomic_path, storage_errors
from shapefit.io.formats import RecordWriter
from shapefit.io.layout import UNKNOWN_UNIT, Layout
from shapefit.io.records import Records
from shapefit.io.tidy_table import IGNORED, Block, Rows, check_columns, columns_of, read_tidy

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


def read_parquet(path: Path, kind: str, *, gaps: bool = False) -> Records:
    """Read the columns that CSV has; null or nan is unknown. `gaps` as in CSV."""
    with _damage(path):
        file = pyarrow.parquet.ParquetFile(
            pyarrow.OSFile(os.fspath(path)), page_checksum_verification=True
        )
        columns = list(file.schema_arrow.names)
        stored = file.schema_arrow.metadata or {}
        own = (b"unit", b"y_axis", b"frame_rate")
        said = {key.decode(): stored[key].decode() for key in own if key in stored}
    if b"landmark_names" in stored or ("item" in columns) > ("landmark" in columns):
        fix = "convert it to HDF5 with the version that wrote it (it has a row per landmark)"
        raise input_error(path, "is a table with one item a row", fix)
    check_columns(columns, kind, str(path))
    rows = Rows(str(path), columns, _blocks(file, path), ": row ")
    records: Records = read_tidy(rows, kind, gaps=gaps)
    rate = said.get("frame_rate")
    return records.replaced(
        unit=said.get("unit", UNKNOWN_UNIT),
        frame_rate=None if rate is None else float(rate),
        y_axis=said.get("y_axis", records.y_axis) if kind != "shapes" else None,
    )


def parquet_kind(path: Path) -> str:
    """Return what a table holds: landmarks, or shapes where it has the column z."""
    with _damage(path):
        names = pyarrow.parquet.read_schema(str(path)).names
    return "shapes" if "z" in names else "landmarks"


def _blocks(file: Any, path: Path) -> Iterator[Block]:
    """Read the rows in order; the first one is 1."""
    start = 1
    with _damage(path):
        for batch in file.iter_batches(ROWS, use_threads=False):
            columns = dict(zip(file.schema_arrow.names, batch.columns, strict=True))
            texts = {name: _texts(columns[name]) for name in TEXTS if name in columns}
            numbers = {
                name: _numbers(values, f"{path}: column {name}")
                for name, values in columns.items()
                if name not in texts and name not in IGNORED
            }
            if len(batch):
                yield Block(texts, np.arange(start, start + len(batch)), numbers)
            start += len(batch)


class ParquetWriter(RecordWriter[Records]):
    """Appends records as rows with the columns that CSV has, numbers as they are."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self._path = path
        self._writer: Any = None

    def append(self, record: Records) -> None:
        """Write one row for each landmark of each item.

        Raises ValueError where the columns are not those of the first record.
        """
        if not self.begun:
            schema = _table(record, slice(0)).schema
            self._writer = pyarrow.parquet.ParquetWriter(
                str(self._path), schema, compression="zstd", write_page_checksum=True
            )
            self.begun = True
        for start in range(0, len(record), ROWS):
            table = _table(record, slice(start, start + ROWS))
            if table.schema != self._writer.schema:
                raise ValueError("the columns of this record are not those of the first")
            self._writer.write_table(table)

    def close(self) -> None:
        """Write what ends the file."""
        if self.begun:
            self._writer.close()


@contextmanager
def parquet_output(target: Path, form: Layout) -> Iterator[ParquetWriter]:
    """Give a writer to a file that appears on a clean exit."""
    with atomic_path(target) as path, storage_errors(target, None):
        writer = ParquetWriter(path)
        try:
            yield writer
        finally:
            writer.close()
        writer.check_begun()


def write_columns(path: Path, columns: Mapping[str, Any]) -> None:
    """Write a table of its own: columns by their names."""
    pyarrow.parquet.write_table(
        pyarrow.table(dict(columns)), path, compression="zstd", write_page_checksum=True
    )


def _table(record: Records, part: slice) -> Any:
    """Return some items as a table of arrow."""
    items, names = record.items[part], record.landmark_names
    item, landmark = np.divmod(np.arange(len(items) * len(names)), max(len(names), 1))
    numbers, of_items = columns_of(record, part)
    columns = {"item": _coded(items, item), "landmark": _coded(names, landmark)}
    columns |= {name: values.reshape(-1) for name, values in numbers.items()}
    for name, values in of_items.items():
        text = name in TEXTS
        columns[name] = (
            _coded(values, item) if text else np.repeat(np.array(values, bool), len(names))
        )
    rate = record.frame_rate
    metadata = {
        "unit": record.unit if record.unit != UNKNOWN_UNIT else None,
        "y_axis": record.y_axis,
        "frame_rate": None if rate is None else repr(float(rate)),
    }
    known = {name: value for name, value in metadata.items() if value}
    return pyarrow.table(columns).replace_schema_metadata(known)


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
