"""The formats of files: those of the package, read and written, and those written for other tools.

The formats of other tools that are read are in `io/detect.py`, which imports all their readers.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from difflib import get_close_matches
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, NamedTuple

from shapefit.errors import input_error, listed
from shapefit.io.inputs import (
    BYTE_ORDER_MARK,
    HDF5_SIGNATURE,
    is_stream,
    read_head,
    source_name,
)
from shapefit.io.layout import LANDMARKS, RESULTS, Layout
from shapefit.io.options import AS_KNOWN, OutputOptions, RecordWriter
from shapefit.io.records import LandmarkSet, ResultSet

Output = AbstractContextManager[RecordWriter[Any]]


class FileFormat(NamedTuple):
    """A format of files.

    title        what a file of it is called, with its article
    suffixes     endings of its names; files of these names are taken for it first, and an output of
                 such a name is written in it
    records      the kinds (landmarks, shapes, ...) that it can hold; the content of a file decides
    recognise    whether a file with such a `Head` is in this format
    read_poses   of a format of another tool: takes the paths that belong together, returns Poses
    together     files of one folder are one recording: a frame each, or parts that need each other
    folders      a folder is an input, too
    write        takes a path and the layout of the records, gives a RecordWriter in a `with`
    writes       the kinds that it can write
    in_metres    what it writes is in metres and upright, a sequence a file; `write` takes
                 OutputOptions, too
    angles       it is written with the joint angles of bodies, or holds nothing else
    points_only  it has no place for what is not a point: attributes, further datasets
    states_y_axis  whether y points up or down is known of each of its files
    """

    title: str
    suffixes: tuple[str, ...]
    records: tuple[str, ...] = ()
    recognise: Callable[[Any], bool] = lambda head: False
    read_poses: Callable[[tuple[Path, ...]], Any] | None = None
    together: bool = False
    folders: bool = False
    write: Callable[..., Output] | None = None
    writes: tuple[str, ...] = ()
    in_metres: bool = False
    angles: bool = False
    points_only: bool = True
    states_y_axis: bool = True

    def has_suffix(self, path: Path) -> bool:
        """Whether the path is named like a file of this format."""
        return path.name.lower().removesuffix(".gz").endswith(self.suffixes)


def _write_hdf5(target: Path, form: Layout) -> Output:
    from shapefit.io.hdf5_records import hdf5_output

    return hdf5_output(target, form)


def _write_csv(target: Path, form: Layout) -> Output:
    from shapefit.io.csv_file import csv_output

    return csv_output(target)


def _write_motion(name: str, target: Path, form: Layout, options: OutputOptions) -> Output:
    from shapefit.io.writers import tables
    from shapefit.io.writers.bvh import write_bvh
    from shapefit.io.writers.motion import motion_output

    if name == "c3d":
        tables.load_ezc3d()
    writers = {"bvh": write_bvh, "c3d": tables.write_c3d, "trc": tables.write_trc}
    writers |= {"mot": tables.write_mot, "metres": tables.write_metres}
    writers |= {"angles": tables.write_angles}
    unit, angles = "mm" if name == "c3d" else "m", WRITTEN[name].angles
    return motion_output(target, options, writers[name], unit=unit, angles=angles)


HEAD_BYTES = 4096
"""Of a file that decide its format, where it is neither JSON nor HDF5."""

ITEMS = ("landmarks", "shapes", "result")
ALL = (*ITEMS, "dictionary")

HDF5 = FileFormat(
    "an HDF5 file",
    (".h5", ".hdf5", ".hdf", ".he5"),
    ALL,
    write=_write_hdf5,
    writes=ALL,
    points_only=False,
)

CSV = FileFormat(
    "a CSV file", (".csv",), ITEMS, write=_write_csv, writes=ITEMS, states_y_axis=False
)

OWN = {"hdf5": HDF5, "csv": CSV}

WRITTEN = {
    name: FileFormat(
        title,
        (suffix,),
        write=partial(_write_motion, name),
        writes=("shapes", "result"),
        in_metres=True,
        angles=name in ("trc", "mot", "angles"),
    )
    for name, title, suffix in (
        ("bvh", "a BVH file", ".bvh"),
        ("c3d", "a C3D file", ".c3d"),
        ("trc", "a TRC file", ".trc"),
        ("mot", "a MOT file", ".mot"),
        ("metres", "a table in metres", ".metres.csv"),
        ("angles", "a table of joint angles", ".angles.csv"),
    )
}
"""Formats that are written for other tools."""

TARGETS = OWN | WRITTEN
"""The formats that can be written, by their names."""


def own_format(path: Path) -> FileFormat | None:
    """Return the format of a file that is ours: CSV by its columns, HDF5 by its attribute `format`.

    Standard input is CSV. None for what is something else, or cannot be read.
    """
    if is_stream(path):
        return CSV
    try:
        state = path.stat()
        return _recognised(path, state.st_mtime_ns, state.st_size) if path.is_file() else None
    except OSError:
        return None


@lru_cache
def _recognised(path: Path, *_state: int) -> FileFormat | None:
    """Return the format of a file of ours; `_state`, its size and time, is the key of the cache."""
    head = read_head(path, HEAD_BYTES)
    if head.startswith(HDF5_SIGNATURE):
        from shapefit.io.hdf5_file import as_text, open_hdf5

        try:
            with open_hdf5(path) as file:
                stated = str(as_text(file.attrs.get("format", "")))
                return HDF5 if stated.startswith("shapefit-") else None
        except Exception:  # h5py has many kinds of error for damaged files: the reader names it
            return HDF5
    return CSV if names_items(head) and not HDF5.has_suffix(path) else None


def names_items(head: bytes) -> bool:
    """Whether text begins with a header that has the columns item and landmark."""
    line = head.removeprefix(BYTE_ORDER_MARK).replace(b"\r", b"\n").partition(b"\n")[0]
    return {b"item", b"landmark"} <= {cell.strip(b' "\t') for cell in line.split(b",")}


def named_format(name: str, formats: Mapping[str, FileFormat], key: str = "format") -> FileFormat:
    """Return the format of a name. Raises InputError at the key for unknown ones."""
    if name not in formats:
        near = get_close_matches(name, formats, n=1, cutoff=0.4)
        fix = f"did you mean {near[0]}?" if near else f"use auto, {listed(formats)}"
        raise input_error(key, f"there is no format {name!r}", fix)
    return formats[name]


def check_holds(path: Path, kind: str, file_format: FileFormat) -> None:
    """Raise InputError unless a file is in one of our formats that can hold records of a kind."""
    if file_format.read_poses is not None or kind not in file_format.records:
        able = [own.title for own in OWN.values() if kind in own.records]
        problem = f"is {file_format.title}, not {listed(able)}"
        problem = problem if path.is_file() else "is not a file on a disk"
        raise input_error(source_name(path), problem, f"give a shapefit-{kind} file")


def landmark_writer(target: Path) -> AbstractContextManager[RecordWriter[LandmarkSet]]:
    """Give a writer of landmarks for use in a `with`; `append` takes chunk after chunk.

    A name that ends in .csv and `-` (standard output) give CSV, one in .h5 or without an ending
    HDF5. The file replaces `target` on a clean exit and leaves nothing behind on an error. At least
    one record must be appended; it may be empty. Raises InputError where the target cannot be
    written.
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
    file_format = check_target_format(target, form.kind, to)
    if is_stream(target) and file_format is not CSV:
        problem = "files of this format cannot go to standard output"
        raise input_error("output", problem, "name a file")
    assert file_format.write is not None
    if file_format.in_metres:
        return file_format.write(target, form, options)
    if options.given:
        problem = f"{file_format.title} keeps the unit and the axes of what is written"
        fix = "leave it out, or end the name in .metres.csv, .trc or .c3d"
        raise input_error(options.given[0], problem, fix)
    return file_format.write(target, form)


def find_target_format(path: Path, name: str = "auto") -> FileFormat:
    """Return the format that an output path asks for: CSV for `-`, HDF5 for a name without ending.

    With another `name` than auto it is that format. Raises InputError for an ending of no format.
    """
    if name != "auto":
        return named_format(name, TARGETS, "to")
    if is_stream(path):
        return CSV
    endings = {suffix: target for target in TARGETS.values() for suffix in target.suffixes}
    if fitting := [suffix for suffix in endings if path.name.lower().endswith(suffix)]:
        return endings[max(fitting, key=len)]
    if path.suffix:
        problem = f"no format that is written ends in {path.suffix}"
        raise input_error(path, problem, f"end the name in {listed(endings)}")
    return HDF5


def check_target_format(path: Path, kind: str, name: str = "auto") -> FileFormat:
    """Return the format of an output. Raises InputError where it cannot hold records of a kind."""
    target = find_target_format(path, name)
    if kind in target.writes:
        return target
    noun = target.title.split()[1]
    if kind == "landmarks" and target.in_metres:
        fix = "lift them with `shapefit fit` first, or write .h5 or .csv"
        raise input_error(path, f"2D landmarks cannot be {noun}", fix)
    raise input_error(path, f"a {kind} cannot be {noun}", "give it a name in .h5")
