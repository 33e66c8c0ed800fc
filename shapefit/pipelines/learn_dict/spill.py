"""Arrays that are too large for memory: rows in an unnamed temporary file, given out in batches."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from math import prod
from pathlib import Path
from tempfile import TemporaryFile

import numpy as np
from numpy.typing import NDArray

from shapefit.errors import input_error
from shapefit.io.memory import in_words

Floats = NDArray[np.float64]


class Spill:
    """Rows of numbers (n, *row) on the disk; iterating gives them in order, `batch` at a time.

    The file is in `folder` without a name: it goes with the object, or with the process. Raises
    InputError where it cannot be written.
    """

    def __init__(self, folder: Path, row: tuple[int, ...], batch: int) -> None:
        self._folder, self._row, self._batch = folder, row, batch
        self._count = 0
        try:
            self._file = TemporaryFile(dir=folder)  # noqa: SIM115
        except OSError as error:
            raise self._refusal(error) from None

    def __len__(self) -> int:
        return self._count

    def __iter__(self) -> Iterator[Floats]:
        size, end = 8 * prod(self._row), self._count
        for start in range(0, end, self._batch):
            stop = min(start + self._batch, end)
            self._file.seek(start * size)
            values = np.fromfile(self._file, np.float64, (stop - start) * prod(self._row))
            yield values.reshape(-1, *self._row)

    def append(self, rows: Floats) -> None:
        """Add rows (m, *row) at the end."""
        self._write(self._count, rows)
        self._count += len(rows)

    def extend(self, batches: Iterable[Floats]) -> None:
        """Add the rows of each batch; these may be made of the rows that are here already."""
        for rows in batches:
            self.append(rows)

    def replace(self, change: Callable[[Floats], Floats]) -> None:
        """Put what `change` makes of each batch in its place."""
        start = 0
        for rows in self:
            self._write(start, change(rows))
            start += len(rows)

    def take(self, chosen: NDArray[np.intp]) -> Floats:
        """Return the rows of these numbers, which ascend."""
        found, start = [], 0
        for rows in self:
            first, last = np.searchsorted(chosen, [start, start + len(rows)])
            found.append(rows[chosen[first:last] - start])
            start += len(rows)
        return np.concatenate(found)

    def _write(self, start: int, rows: Floats) -> None:
        try:
            self._file.seek(8 * prod(self._row) * start)
            self._file.write(np.ascontiguousarray(rows, dtype=np.float64).data)
            self._file.flush()
        except OSError as error:
            raise self._refusal(error) from None

    def _refusal(self, error: OSError) -> Exception:
        size = in_words(8 * prod(self._row) * self._count)
        found = f"the temporary file of the shapes, {size} so far, cannot be written: "
        fix = "free some space there, or choose another folder for the output"
        return input_error(self._folder, found + (error.strerror or str(error)), fix)
