"""Write records to a Parquet file in row groups."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from io import FileIO
from pathlib import Path
from typing import Any

from shapefit.io.layout import Layout
from shapefit.io.parquet.columns import Column, to_columns
from shapefit.io.parquet.library import pyarrow
from shapefit.io.parquet.metadata import attribute_metadata, file_metadata
from shapefit.io.stored.writer import Array, StoredWriter, check_alike
from shapefit.io.whole.atomic import atomic_file, write_all

GROUP_BYTES = 1 << 25
"""Of the rows of a group, before compression: what a reader has of it in memory."""

STEP, MOST_ROWS = 64, 1 << 17
"""A group has a multiple of STEP rows, so that a fit can be divided between groups."""

COMPRESSION = "zstd"


@contextmanager
def parquet_output(target: Path, form: Layout) -> Iterator[ParquetWriter]:
    """Give a writer to a file that appears on a clean exit."""
    with atomic_file(target) as file:
        sink = _Sink(file)
        writer = ParquetWriter(sink, form)
        try:
            yield writer
            writer.finish()
        except BaseException:
            sink.open = False
            with suppress(Exception):
                writer.close()
            raise


class _Sink:
    """What pyarrow writes to: the file, until it is not `open` any more."""

    closed = False

    def __init__(self, file: FileIO) -> None:
        self._file = file
        self.open = True

    def write(self, data: Any) -> int:
        """Write every byte."""
        if self.open:
            write_all(self._file, memoryview(data).cast("B"))
        return len(data)

    def flush(self) -> None:
        """Do nothing: the file is unbuffered."""

    def close(self) -> None:
        """Do nothing: whoever opened the file closes it."""


class ParquetWriter(StoredWriter):
    """Appends records of one layout to a Parquet file.

    `attributes` are added to the metadata at the end. The file depends on what is written, and not
    on how it is divided into records.
    """

    def __init__(self, sink: _Sink, form: Layout) -> None:
        super().__init__(form)
        self._sink = sink
        self._writer: Any = None
        self._waiting: list[Any] = []

    def _write_items(self, record: Any, further: Mapping[str, Array]) -> None:
        columns = list(to_columns(record, further, self._form))
        if self._writer is None:
            self._begin(columns)
        check_alike([column.field.name for column in columns], self._schema.names)
        arrays = [column.values for column in columns]
        self._waiting.append(pyarrow.Table.from_arrays(arrays, schema=self._schema))
        while sum(map(len, self._waiting)) >= self._group:
            self._write(self._group)

    def finish(self) -> None:
        """Write what waits, and the metadata. Raises ValueError where nothing was appended."""
        self._check_begun()
        rest = sum(map(len, self._waiting))
        if rest:
            self._write(rest)
        self._writer.add_key_value_metadata(attribute_metadata(self.attributes))
        self.close()

    def close(self) -> None:
        """Let go of the file."""
        if self._writer is not None:
            self._writer.close()

    def _begin(self, columns: list[Column]) -> None:
        said = file_metadata(self._form, self._first, self._whole)
        self._schema = pyarrow.schema([column.field for column in columns], said)
        row_bytes = max(sum(column.row_bytes for column in columns), 1)
        self._group = min(max(GROUP_BYTES // row_bytes // STEP, 1) * STEP, MOST_ROWS)
        plain = [c.field.name for c in columns if not pyarrow.types.is_nested(c.field.type)]
        texts = [column.field.name for column in columns if column.is_text]
        self._writer = pyarrow.parquet.ParquetWriter(
            self._sink,
            self._schema,
            compression=COMPRESSION,
            use_dictionary=[name for name in texts if name != "item"],
            write_statistics=plain,
        )

    def _write(self, rows: int) -> None:
        table = pyarrow.concat_tables(self._waiting)
        one = table.slice(0, rows).combine_chunks()  # pages end where the pieces of a table end
        self._writer.write_table(one, row_group_size=rows)
        rest = table.slice(rows)
        self._waiting = [rest] if len(rest) else []
