"""Streaming writers: records in, a whole file out, its format chosen by its name."""

from __future__ import annotations

from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any, Protocol, TypeVar

from shapefit.errors import input_error
from shapefit.io.formats import CSV, find_target_format, find_writer
from shapefit.io.layout import LANDMARKS, RESULTS, Layout
from shapefit.io.options import AS_KNOWN, OutputOptions, Summary
from shapefit.io.records import LandmarkSet, ResultSet
from shapefit.io.sources import is_stream

NOTHING_APPENDED = "nothing was appended; append one record, which may be empty"

R_contra = TypeVar("R_contra", contravariant=True)


class RecordWriter(Protocol[R_contra]):
    """Takes records one after another; `attributes` are stored with the file on a clean exit.

    After that `summary` says what was written.
    """

    attributes: dict[str, str | float | int]
    summary: Summary

    def append(self, record: R_contra, /) -> None:
        """Write the items of a record after those that are there."""


def landmark_writer(target: Path) -> AbstractContextManager[RecordWriter[LandmarkSet]]:
    """Give a writer of landmarks for use in a `with`; `append` takes chunk after chunk.

    A name that ends in .csv and `-` (standard output) give CSV, one in .parquet or .pq Parquet,
    one in .h5 or without an ending HDF5. The file replaces `target` on a clean exit and leaves
    nothing behind on an error. At least one record must be appended; it may be empty. Raises
    InputError where the target cannot be written.
    """
    return record_writer(target, LANDMARKS)


def result_writer(
    target: Path, options: OutputOptions = AS_KNOWN
) -> AbstractContextManager[RecordWriter[ResultSet]]:
    """Write results, as `landmark_writer` writes landmarks."""
    return record_writer(target, RESULTS, options=options)


def record_writer(
    target: Path, form: Layout, to: str = "auto", options: OutputOptions = AS_KNOWN
) -> AbstractContextManager[RecordWriter[Any]]:
    """Write records of one layout, in the format `to`, or in that of the target's name.

    Raises InputError where that format cannot hold them, for all but CSV on standard output, and
    for options that are for files in metres where it is none.
    """
    write = find_writer(target, form.kind, to)
    known = find_target_format(target, to)
    if is_stream(target) and known is not CSV:
        found = "files of this format cannot go to standard output"
        raise input_error("output", found, "name a file")
    if known.in_metres:
        return write(target, form, options)  # type: ignore[no-any-return]
    if options.given:
        found = f"{known.title} keeps the unit and the axes of what is written"
        raise input_error(options.given[0], found, "leave it out, or write TRC or C3D")
    return write(target, form)  # type: ignore[no-any-return]
