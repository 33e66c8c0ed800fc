"""Read a result with all that proves it, some images at a time."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from shapefit.errors import input_error
from shapefit.io.formats import HDF5, find_format
from shapefit.io.layout import AXES, MODES, RESULTS, Dataset
from shapefit.io.records import ResultSet

UNNEEDED = ("sequence", "iterations", "mesh_vertices")
"""Datasets that nothing is claimed of, beside the modes."""


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
        unneeded += MODES
        begin: dict[str, int] = {}
        for start in range(0, self.count, size):
            rows = slice(start, min(start + size, self.count))
            fields = self._reader.fields(rows, without=counted + unneeded)
            for dataset in counted:
                counts = fields.get(dataset.counted_by)
                if counts is None:
                    continue
                first = begin.get(dataset.name, 0)
                end = first + self._total(counts, dataset, rows)
                fields[dataset.attribute] = self._reader.read(dataset.name, slice(first, end))
                self._check_length(dataset, end, last=rows.stop == self.count)
                begin[dataset.name] = end
            yield ResultSet(
                **fields, extras=self._reader.extras(rows), unit=self._reader.unit,
                y_axis=self._reader.y_axis,
            )  # fmt: skip

    def _total(self, counts: Any, dataset: Dataset, rows: slice) -> int:
        most = self.size(str(dataset.axes[0])) or 0
        if dataset.axes[0] == "a":
            most = self.size("k") or most
        wrong = np.flatnonzero((counts < 0) | (counts > most))
        if len(wrong):
            place = self._reader.place(dataset.counted_by, rows.start + int(wrong[0]))
            fix = "the file was changed: fit again"
            what = AXES[str(dataset.axes[0])]
            raise input_error(place, f"is {counts[wrong[0]]}, not a number of {what}", fix)
        return int(counts.sum())

    def _check_length(self, dataset: Dataset, end: int, *, last: bool) -> None:
        axis = str(dataset.axes[0])
        length = self.size(axis) or 0
        if end > length or (last and end != length):
            found = f"holds {length} {AXES[axis]}, and {dataset.counted_by} counts {end}"
            place = self._reader.place(dataset.name)
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
