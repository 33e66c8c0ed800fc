"""Read a result with all that proves it, some images at a time."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from shapefit.errors import input_error
from shapefit.io.formats import HDF5, find_format
from shapefit.io.layout import RESULTS, TRANSFORM_COUNT
from shapefit.io.records import ResultSet

UNNEEDED = ("sequence", "iterations", "mesh_vertices")
"""Datasets that nothing is claimed of."""


class ProofFile:
    """The results of an HDF5 file, with their proofs: `chunks` gives them out in order."""

    def __init__(self, reader: Any) -> None:
        self._reader = reader

    @property
    def count(self) -> int:
        """Number of images."""
        return int(self._reader.count)

    @property
    def landmark_names(self) -> tuple[str, ...]:
        """Names of the landmarks."""
        return tuple(self._reader.landmark_names)

    @property
    def attributes(self) -> Mapping[str, str | float | int]:
        """What is stored with the file: method, config, digests."""
        return dict(self._reader.attributes)

    def size(self, axis: str) -> int | None:
        """Length of an axis, such as k for the atoms; None where nothing has it."""
        found: int | None = self._reader.size(axis)
        return found

    def chunks(self, size: int) -> Iterator[ResultSet]:
        """Give out the results, `size` at a time."""
        counted = [dataset for dataset in RESULTS.datasets if dataset.counted_by]
        unneeded = [dataset for dataset in RESULTS.datasets if dataset.name in UNNEEDED]
        begin = 0
        for start in range(0, self.count, size):
            rows = slice(start, min(start + size, self.count))
            fields = self._reader.fields(rows, without=counted + unneeded)
            counts = fields[TRANSFORM_COUNT.attribute]
            if counts is not None:
                end = begin + self._total(counts, rows)
                pieces = slice(begin, end)
                fields |= {one.attribute: self._reader.read(one.name, pieces) for one in counted}
                self._check_length(end, last=rows.stop == self.count)
                begin = end
            yield ResultSet(
                **fields, extras=self._reader.extras(rows), unit=self._reader.unit,
                y_axis=self._reader.y_axis,
            )  # fmt: skip

    def _total(self, counts: Any, rows: slice) -> int:
        wrong = np.flatnonzero(
            (counts < 0) | (counts > self.size("k") if self.size("k") else False)
        )
        if len(wrong):
            place = self._reader.place(TRANSFORM_COUNT.name, rows.start + int(wrong[0]))
            fix = "the file was changed: fit again"
            raise input_error(place, f"is {counts[wrong[0]]}, not a number of atoms", fix)
        return int(counts.sum())

    def _check_length(self, end: int, *, last: bool) -> None:
        length = self.size("a") or 0
        if end > length or (last and end != length):
            found = f"holds {length} transforms, and {TRANSFORM_COUNT.name} counts {end}"
            place = self._reader.place("active_transforms")
            raise input_error(place, found, "the file was changed: fit again")


@contextmanager
def open_proofs(path: Path) -> Iterator[ProofFile]:
    """Open a result for its proofs. Raises InputError where it is CSV, or not a result."""
    from shapefit.io.hdf5.reading import Hdf5Reader

    if find_format(path) is not HDF5:
        found = "is not HDF5, and CSV holds points only"
        raise input_error(path, found, "give a result that `shapefit fit` wrote to a name in .h5")
    with Hdf5Reader(path, RESULTS) as reader:
        yield ProofFile(reader)
