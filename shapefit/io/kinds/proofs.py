"""Read a result with all that proves it, some images at a time."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from shapefit.errors import input_error
from shapefit.io.formats import find_format
from shapefit.io.layout import RESULTS
from shapefit.io.records import ResultSet
from shapefit.io.stored.files import open_stored, read_rows
from shapefit.io.stored.reader import StoredReader

UNNEEDED = ("iterations", "mesh_vertices")
"""Datasets that nothing is claimed of."""


class ProofFile:
    """The results of a file, with their proofs: `chunks` gives them out in order."""

    def __init__(self, reader: StoredReader) -> None:
        self._reader = reader

    @property
    def count(self) -> int:
        """Number of images."""
        return self._reader.count

    @property
    def landmark_names(self) -> tuple[str, ...]:
        """Names of the landmarks."""
        return self._reader.landmark_names

    @property
    def attributes(self) -> Mapping[str, str | float | int]:
        """What is stored with the file: method, config, digests."""
        return self._reader.attributes

    def size(self, axis: str) -> int | None:
        """Length of an axis, such as k for the atoms; None where nothing has it."""
        return self._reader.size(axis)

    @property
    def names(self) -> frozenset[str]:
        """Names of all datasets of the file."""
        return self._reader.names

    @property
    def head(self) -> ResultSet:
        """All of the results but the images."""
        return read_rows(self._reader, slice(0))

    def chunks(self, size: int, *, sequences: bool = True) -> Iterator[ResultSet]:
        """Give out the results, `size` at a time, with or without the names of sequences."""
        without = UNNEEDED if sequences else (*UNNEEDED, "sequence")
        unneeded = [dataset for dataset in RESULTS.datasets if dataset.name in without]
        for start in range(0, self.count, size):
            rows = slice(start, min(start + size, self.count))
            yield read_rows(self._reader, rows, unneeded)


@contextmanager
def open_proofs(path: Path) -> Iterator[ProofFile]:
    """Open a result for its proofs. Raises InputError where it is CSV, or not a result."""
    if find_format(path).reader is None:
        found = "is neither HDF5 nor Parquet, and CSV holds points only"
        fix = "give a result that `shapefit fit` wrote to a name in .h5 or .parquet"
        raise input_error(path, found, fix)
    with open_stored(path, RESULTS) as reader:
        yield ProofFile(reader)
