"""Streaming writers: records in, a whole file out, HDF5 or CSV by its name."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import Any, Protocol, TypeVar

from shapefit.io.layout import LANDMARKS, RESULTS, Format
from shapefit.io.records import LandmarkSet, ResultSet
from shapefit.io.sources import is_csv_target
from shapefit.io.whole.atomic import atomic_file

R_contra = TypeVar("R_contra", contravariant=True)


class RecordWriter(Protocol[R_contra]):
    """Takes records one after another; `attributes` are stored with the file on a clean exit."""

    attributes: dict[str, str | float | int]

    def append(self, record: R_contra, /) -> None:
        """Write the items of a record after those that are there."""


def landmark_writer(target: Path) -> AbstractContextManager[RecordWriter[LandmarkSet]]:
    """Give a writer of landmarks for use in a `with`; `append` takes chunk after chunk.

    A name that ends in .csv and `-` (standard output) give CSV, all others HDF5. The file
    replaces `target` on a clean exit and leaves nothing behind on an error. At least one record
    must be appended; it may be empty. Raises InputError where the target cannot be written.
    """
    return record_writer(target, LANDMARKS)


def result_writer(target: Path) -> AbstractContextManager[RecordWriter[ResultSet]]:
    """Write results, as `landmark_writer` writes landmarks."""
    return record_writer(target, RESULTS)


@contextmanager
def record_writer(target: Path, form: Format) -> Iterator[RecordWriter[Any]]:
    """Write records of a format to HDF5 or, where the format has a table, to CSV."""
    if is_csv_target(target):
        from shapefit.io.csv.writing import csv_output

        with csv_output(target) as table:
            yield table
        return
    with atomic_file(target) as file:
        from shapefit.io.hdf5.writing import Hdf5Writer

        with Hdf5Writer(file, form) as writer:
            yield writer
