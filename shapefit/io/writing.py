"""Records in, a whole file out: the formats that are written, chosen by the name of the file."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any, Protocol, TypeVar

from shapefit.errors import input_error, listed
from shapefit.io.formats import CSV, FORMATS, HDF5, FileFormat, load, named_format
from shapefit.io.inputs import is_stream
from shapefit.io.layout import LANDMARKS, RESULTS, Layout
from shapefit.io.options import AS_KNOWN, OutputOptions, Summary
from shapefit.io.records import LandmarkSet, ResultSet

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


def _metres(title: str, suffix: str, writer: str) -> FileFormat:
    """Return the row of files in metres; the writer is named below `shapefit.io.written`."""
    return FileFormat(
        title=title,
        suffixes=(suffix,),
        writer=f".written.{writer}",
        writes=("shapes", "result"),
        in_metres=True,
    )


WRITTEN: dict[str, FileFormat] = {
    "bvh": _metres("a BVH file", ".bvh", "bones:bvh_output"),
    "c3d": _metres("a C3D file", ".c3d", "markers:c3d_output"),
    "glb": _metres("a GLB file", ".glb", "glb:glb_output"),
    "trc": _metres("a TRC file", ".trc", "markers:trc_output"),
}
"""Formats that are written for other tools; those of them that can be read have a row above."""


def targets() -> dict[str, FileFormat]:
    """Return the formats that can be written, by their names."""
    own = {name: known for name, known in FORMATS.items() if known.writer}
    return own | WRITTEN


def find_target_format(path: Path, name: str = "auto") -> FileFormat:
    """Return the format that an output path asks for: CSV for `-`, HDF5 for a name without ending.

    With another `name` than auto it is that format. Raises InputError for an ending of no format.
    """
    if name != "auto":
        return named_format(name, targets(), "to")
    if is_stream(path):
        return CSV
    for known in targets().values():
        if known.has_suffix(path):
            return known
    if path.suffix:
        endings = [suffix for known in targets().values() for suffix in known.suffixes]
        found = f"no format that is written ends in {path.suffix}"
        raise input_error(path, found, f"end the name in {listed(endings)}")
    return HDF5


def find_writer(path: Path, kind: str, name: str = "auto") -> Callable[..., Any]:
    """Return what writes records of a kind. Raises InputError where the format cannot hold them."""
    known = find_target_format(path, name)
    if known.writer is None or kind not in known.writes:
        name = known.title.split()[1]
        if kind == "landmarks" and known.in_metres:
            fix = "lift them with `shapefit fit` first, or write .h5 or .csv"
            raise input_error(path, f"2D landmarks cannot be {name}", fix)
        raise input_error(path, f"a {kind} cannot be {name}", "give it a name in .h5")
    return load(known.writer)
