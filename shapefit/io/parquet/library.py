"""pyarrow, the extra `parquet`, and columns that it reads forwards, a batch of rows at a time."""

from __future__ import annotations

from bisect import bisect_right
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from itertools import accumulate
from pathlib import Path
from typing import Any

from shapefit.errors import input_error

try:
    import pyarrow
    import pyarrow.compute
    import pyarrow.parquet
except ImportError as error:
    found = "these files need the library pyarrow, which is not installed"
    raise input_error("Parquet", found, "run `pip install pyarrow`") from error

__all__ = ["damage", "pyarrow"]

FAULTS = (
    *(pyarrow.ArrowException, OSError, RuntimeError),
    *(KeyError, TypeError, ValueError, MemoryError),
)


@contextmanager
def damage(place: str | Path) -> Iterator[None]:
    """Turn what pyarrow raises for a truncated or damaged file into an InputError."""
    try:
        yield
    except FAULTS as error:
        reason = str(error).partition("\n")[0] or type(error).__name__
        fix = "the file may be cut off or damaged: copy or make it again"
        raise input_error(place, f"cannot be read ({reason})", fix) from error


BATCH = 16384
"""Rows that are decoded at a time."""


def row_group_starts(file: Any) -> list[int]:
    """Return the first row of every row group of an open file, and the number of all rows."""
    metadata = file.metadata
    sizes = (metadata.row_group(group).num_rows for group in range(metadata.num_row_groups))
    return [*accumulate(sizes, initial=0)]


def stored_bytes(file: Any) -> Counter[str]:
    """Return how many bytes the values of each column have, encoded but not compressed."""
    names = file.schema_arrow.names
    total: Counter[str] = Counter()
    for group in map(file.metadata.row_group, range(file.metadata.num_row_groups)):
        for stored in map(group.column, range(group.num_columns)):
            path = stored.path_in_schema
            name = path if path in names else path.partition(".")[0]
            total[name] += stored.total_uncompressed_size
    return total


class ColumnStream:
    """Some columns of an open file.

    Rows that follow those read last are decoded next; all others from the start of their row
    group. So a file is decoded once where it is read in order, whatever its row groups.
    """

    def __init__(self, file: Any, columns: Sequence[str]) -> None:
        self._file = file
        self._columns = list(columns)
        self._starts = row_group_starts(file)
        self._batches: Iterator[Any] = iter(())
        self._held: Any = None
        self._row = 0

    def read(self, start: int, stop: int) -> Any:
        """Return these rows as a table, each of its columns in one piece."""
        if self._held is None or start < self._row or self._group(start) > self._group(self._row):
            self._row = self._starts[self._group(start)]
            self._batches = _decoded(self._file, self._group(start), self._columns)
            self._held = self._file.schema_arrow.empty_table().select(self._columns)
        parts = []
        while self._row < stop:
            if not len(self._held):
                batch = next(self._batches, None)
                if batch is None:
                    raise ValueError("a row group has fewer rows than it says")
                self._held = pyarrow.Table.from_batches([batch])
            skipped = min(max(start - self._row, 0), len(self._held))
            taken = min(stop - self._row, len(self._held))
            parts.append(self._held.slice(skipped, taken - skipped))
            self._held = self._held.slice(taken)
            self._row += taken
        if not parts:
            return self._held.slice(0, 0).combine_chunks()
        return pyarrow.concat_tables(parts).combine_chunks()

    def _group(self, row: int) -> int:
        """Return the row group of a row; the last one for the end of the file."""
        return max(min(bisect_right(self._starts, row), len(self._starts) - 1) - 1, 0)


def _decoded(file: Any, first: int, columns: list[str]) -> Iterator[Any]:
    """Yield what the row groups from the first on hold.

    Of each by itself: pyarrow decodes the lists of all groups that it is asked for at once.
    """
    for group in range(first, file.metadata.num_row_groups):
        yield from file.iter_batches(BATCH, [group], columns, use_threads=False)
