"""Columns of values and of texts that grow without limit: in memory while small, then in files.

The pages of a memory map would count as memory of the process: 128 MB of numbers take 128 MB there,
1 MB here. And a full disk would kill it.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import pairwise
from math import prod
from pathlib import Path
from tempfile import SpooledTemporaryFile
from typing import Any
from weakref import finalize

import numpy as np
from numpy.typing import DTypeLike, NDArray

from shapefit.io.whole.atomic import storage_errors, write_all

MOST_HELD = 1 << 19
"""Bytes of a column that are in memory; more are in an unnamed file, which no run leaves behind."""

GAP, STRETCH = 1 << 10, 1 << 14
"""Rows that are read and dropped rather than begun anew behind them; numbers read at once."""

AT_A_TIME = 1 << 14
"""Texts that are read at a time."""


def nearest_folder(output: Path) -> Path | None:
    """Return the output where it is a folder, else the nearest one around it; None for a URL."""
    return next((folder for folder in (output, *output.parents) if folder.is_dir()), None)


class Column:
    """Rows of one type and shape: appended, then read and written by slices like an array.

    folder of its file; None for that of the system's temporary files. What writes raises
    InputError where the disk is full.
    """

    def __init__(self, folder: Path | None, dtype: DTypeLike, shape: tuple[int, ...] = ()) -> None:
        self._folder = folder
        self._dtype, self._shape = np.dtype(dtype), shape
        self._row_bytes = self._dtype.itemsize * prod(shape)
        place = None if folder is None else str(folder)
        self._file: Any = SpooledTemporaryFile(MOST_HELD, dir=place, buffering=0)  # noqa: SIM115
        finalize(self, self._file.close)
        self._count = 0

    def __len__(self) -> int:
        return self._count

    def append(self, rows: NDArray[Any]) -> None:
        """Append rows, an array of them."""
        self._write(self._count, rows)
        self._count += len(rows)

    def __getitem__(self, rows: slice) -> NDArray[Any]:
        start, stop, _ = rows.indices(self._count)
        found = np.empty((max(stop - start, 0), *self._shape), self._dtype)
        rest = _bytes_of(found)
        self._file.seek(start * self._row_bytes)
        while rest:
            rest = rest[self._file.readinto(rest) :]
        return found

    def __setitem__(self, rows: slice, values: NDArray[Any]) -> None:
        """Put other values in the place of rows."""
        self._write(rows.indices(self._count)[0], values)

    def take(self, rows: NDArray[np.intp]) -> NDArray[Any]:
        """Return these rows, in their order."""
        unique, places = np.unique(rows, return_inverse=True)
        found = np.empty((len(unique), *self._shape), self._dtype)
        for part in stretches(unique, max(1, STRETCH // prod(self._shape))):
            own = unique[part]
            found[part] = self[own[0] : own[-1] + 1][own - own[0]]
        return found[places.reshape(-1)]

    def _write(self, start: int, rows: NDArray[Any]) -> None:
        with storage_errors(self._folder or Path("TMPDIR"), None, "used for temporary files"):
            self._file.seek(start * self._row_bytes)
            write_all(self._file, _bytes_of(np.ascontiguousarray(rows, self._dtype)))


def _bytes_of(array: NDArray[Any]) -> memoryview:
    """Return the bytes of an array that lies in one piece."""
    return array.reshape(-1).view(np.uint8).data


@dataclass(frozen=True)
class Batched:
    """The rows of a column, `size` at a time, as often as they are asked for."""

    column: Column
    size: int

    def __len__(self) -> int:
        return len(self.column)

    def __iter__(self) -> Iterator[NDArray[Any]]:
        return (self.column[rows] for rows in self.slices())

    def slices(self) -> Iterator[slice]:
        """Yield the rows of each batch, of those that are there now."""
        count = len(self.column)
        return (slice(row, min(row + self.size, count)) for row in range(0, count, self.size))


def stretches(rows: NDArray[np.intp], most: int | None = None) -> Iterator[slice]:
    """Cut ascending rows where a gap is not worth reading, and after `most` rows.

    A slice of `rows` each.
    """
    most = STRETCH if most is None else most
    start = 0
    ends = [*(np.flatnonzero(np.diff(rows) > GAP) + 1).tolist(), len(rows)] if len(rows) else []
    for end in ends:
        while start < end:
            reach = int(np.searchsorted(rows[start:end], rows[start] + most))
            yield slice(start, start + reach)
            start += reach


class Texts:
    """Texts that are appended, such as names of items, then read by slices like a tuple."""

    def __init__(self, folder: Path | None) -> None:
        self._letters = Column(folder, np.uint8)
        self._ends = Column(folder, np.int64)

    def __len__(self) -> int:
        return len(self._ends)

    def append(self, texts: Iterable[str]) -> None:
        """Append texts."""
        encoded = [text.encode("utf-8", "surrogatepass") for text in texts]
        sizes = np.fromiter(map(len, encoded), np.int64, len(encoded))
        before = len(self._letters)
        self._letters.append(np.frombuffer(b"".join(encoded), np.uint8))
        self._ends.append(before + np.cumsum(sizes))

    def encoded(self, rows: slice) -> tuple[bytes, NDArray[np.int64]]:
        """Return the letters of n texts, and where each starts and the last ends (n + 1,)."""
        start, stop, _ = rows.indices(len(self))
        ends = self._ends[max(start - 1, 0) : max(start, stop)]
        if start == 0:
            ends = np.concatenate([[0], ends])
        return self._letters[int(ends[0]) : int(ends[-1])].tobytes(), ends - ends[0]

    def __getitem__(self, rows: slice) -> tuple[str, ...]:
        letters, ends = self.encoded(rows)
        places = ends.tolist()
        if letters.isascii():
            text = letters.decode("ascii")
            return tuple(text[a:b] for a, b in pairwise(places))
        return tuple(letters[a:b].decode("utf-8", "surrogatepass") for a, b in pairwise(places))

    def take(self, rows: NDArray[np.intp]) -> tuple[str, ...]:
        """Return the texts of these rows, in their order."""
        unique, places = np.unique(rows, return_inverse=True)
        found: list[str] = []
        for part in stretches(unique):
            own = unique[part]
            read = self[int(own[0]) : int(own[-1]) + 1]
            found += [read[row] for row in (own - own[0]).tolist()]
        return tuple(found[place] for place in places.reshape(-1).tolist())

    def blocks(self, start: int = 0, stop: int | None = None) -> Iterator[tuple[str, ...]]:
        """Read the texts of these rows, some thousand at a time."""
        end = len(self) if stop is None else stop
        return (self[row : min(row + AT_A_TIME, end)] for row in range(start, end, AT_A_TIME))
