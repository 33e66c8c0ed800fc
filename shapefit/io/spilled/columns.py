"""Columns of values that grow without limit: the last block is in memory, the others in a file."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from math import prod
from pathlib import Path
from tempfile import TemporaryFile
from typing import IO, Any, Self

import numpy as np
from numpy.typing import DTypeLike, NDArray

from shapefit.io.whole.atomic import storage_errors

BLOCK = 1 << 16
"""Values of a column that are written, and held, at a time: whole rows."""

GAP = 1 << 10
"""Rows that are read and dropped rather than begun anew behind them."""


def nearest_folder(output: Path) -> Path | None:
    """Return the output where it is a folder, else the nearest one around it; None for a URL."""
    return next((folder for folder in (output, *output.parents) if folder.is_dir()), None)


class Spill:
    """The unnamed file that columns share; it is made when the first block is full.

    A context manager, which closes the file. No run leaves it behind, not even one that is killed.
    """

    def __init__(self, folder: Path | None = None) -> None:
        """Take the folder to make the file in; None for that of the system's temporary files."""
        self.folder = folder
        self._file: IO[bytes] | None = None
        self._end = 0

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None:
        if self._file is not None:
            self._file.close()

    def write(self, block: NDArray[Any]) -> int:
        """Write a block, which lies in one piece, at the end; return its place.

        Raises InputError where the disk is full.
        """
        place, self._end = self._end, self._end + block.nbytes
        self.write_at(place, block)
        return place

    def write_at(self, place: int, block: NDArray[Any]) -> None:
        """Write a block, which lies in one piece, at a place. Raises InputError as `write`."""
        with storage_errors(self.folder or Path("TMPDIR"), None, "used for temporary files"):
            if self._file is None:
                self._file = TemporaryFile(dir=self.folder, buffering=0)  # noqa: SIM115
            rest = block.reshape(-1).view(np.uint8).data
            self._file.seek(place)
            while rest:
                rest = rest[self._file.write(rest) :]

    def read(self, place: int, into: NDArray[Any]) -> None:
        """Fill an array, which lies in one piece, with the bytes from a place on."""
        assert self._file is not None  # whoever has a place wrote to it
        rest = into.reshape(-1).view(np.uint8).data
        self._file.seek(place)
        while rest:
            rest = rest[self._file.readinto(rest) :]  # type: ignore[attr-defined]


class Column:
    """Rows of one type and shape: appended, then read and written by slices like an array."""

    def __init__(self, spill: Spill, dtype: DTypeLike, shape: tuple[int, ...] = ()) -> None:
        self._spill = spill
        self._dtype = np.dtype(dtype)
        self._shape = shape
        self._block = max(1, BLOCK // prod(shape))
        self._places: list[int] = []
        self._held: list[NDArray[Any]] = []
        self._count = 0

    def __len__(self) -> int:
        return self._count

    def append(self, rows: NDArray[Any]) -> None:
        """Append rows, an array of them."""
        self._held.append(np.array(rows, self._dtype).reshape(-1, *self._shape))
        self._count += len(rows)
        if self._count - len(self._places) * self._block >= self._block:
            held = self._last()
            full = len(held) // self._block * self._block
            for start in range(0, full, self._block):
                self._places.append(self._spill.write(held[start : start + self._block]))
            self._held = [held[full:].copy()]

    def __getitem__(self, rows: slice) -> NDArray[Any]:
        start, stop, _ = rows.indices(self._count)
        found = np.empty((max(stop - start, 0), *self._shape), self._dtype)
        for own, place, held in self._pieces(start, stop):
            if place is None:
                found[own] = self._last()[held]
            else:
                self._spill.read(place, found[own])
        return found

    def __setitem__(self, rows: slice, values: NDArray[Any]) -> None:
        """Put other values in the place of rows. Raises InputError where the disk is full."""
        start, stop, _ = rows.indices(self._count)
        new = np.ascontiguousarray(values, self._dtype)
        for own, place, held in self._pieces(start, stop):
            if place is None:
                self._last()[held] = new[own]
            else:
                self._spill.write_at(place, new[own])

    def _pieces(self, start: int, stop: int) -> Iterator[tuple[slice, int | None, slice]]:
        """Cut rows where blocks end: which from `start` on, their place in the file, or in memory.

        The place is None for those that are in memory.
        """
        row_bytes = self._dtype.itemsize * prod(self._shape)
        row = start
        while row < stop:
            number, first = divmod(row, self._block)
            size = min(self._block - first, stop - row)
            in_file = number < len(self._places)
            place = self._places[number] + first * row_bytes if in_file else None
            yield slice(row - start, row - start + size), place, slice(first, first + size)
            row += size

    def take(self, rows: NDArray[np.intp]) -> NDArray[Any]:
        """Return these rows, in their order."""
        unique, places = np.unique(rows, return_inverse=True)
        found = np.empty((len(unique), *self._shape), self._dtype)
        for part in stretches(unique, self._block // 4):
            own = unique[part]
            found[part] = self[own[0] : own[-1] + 1][own - own[0]]
        return found[places.reshape(-1)]

    def _last(self) -> NDArray[Any]:
        """Return the rows that are in memory."""
        if len(self._held) != 1:
            none = np.empty((0, *self._shape), self._dtype)
            self._held = [np.concatenate([none, *self._held])]
        return self._held[0]


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
    """Cut ascending rows where a gap is not worth reading, and after `most` (some thousand) rows.

    A slice of `rows` each.
    """
    most = max(1, BLOCK // 4 if most is None else most)
    start = 0
    ends = [*(np.flatnonzero(np.diff(rows) > GAP) + 1).tolist(), len(rows)] if len(rows) else []
    for end in ends:
        while start < end:
            reach = int(np.searchsorted(rows[start:end], rows[start] + most))
            yield slice(start, start + reach)
            start += reach
