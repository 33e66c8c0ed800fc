"""The formats of files: those of the package, read and written, and those written for
other tools.

The formats of other tools that are read are in `io/detect.py`, which imports all their
readers.
"""

from __future__ import annotations

import os
import zlib
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager, suppress
from functools import cached_property, partial
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from shapefit.errors import InputError, input_error, listed
from shapefit.io.inputs import (
    BYTE_ORDER_MARK,
    GZIP_SIGNATURE,
    HDF5_SIGNATURE,
    UTF16_MARKS,
    is_stream,
    read_head,
    source_name,
)
from shapefit.io.layout import LANDMARKS, RESULTS, Layout
from shapefit.io.options import BY_DEFAULT, OutputOptions, RecordWriter

if TYPE_CHECKING:
    from shapefit.io.readers.poses import Poses

Output = AbstractContextManager[RecordWriter[Any]]

HEAD_BYTES = 4096
"""Of a file that decide its format, where it is neither JSON nor HDF5."""

MARK = "shapefit-"
"""Beginning of the attribute `format` of our HDF5."""

FIRST = 20
"""Entries of JSON, and files of a folder, that decide its format."""

MAX_LEVELS = 8
"""Of JSON of an unknown kind that are looked through."""

MAX_VALUES_PER_LEVEL = 1000
"""Of such JSON that are looked at."""


class Head:
    """What decides the format of a file: its first bytes, lines and columns, or
    keys.
    """

    def __init__(self, path: Path) -> None:
        """Read the first bytes of a file, gunzipped; InputError if it is unreadable."""
        self.path, self.bytes = path, read_head(path, HEAD_BYTES)
        if self.bytes.startswith(GZIP_SIGNATURE):
            with suppress(zlib.error):
                gzip_bits = 16 + zlib.MAX_WBITS
                self.bytes = zlib.decompressobj(gzip_bits).decompress(
                    self.bytes, HEAD_BYTES
                )
        self.is_utf16 = self.bytes.startswith(UTF16_MARKS)
        self.text = self.bytes.removeprefix(BYTE_ORDER_MARK)
        if self.is_utf16:
            self.text = self.bytes.decode("utf-16", "replace").encode()
        self.lines = (
            self.text.replace(b"\r\n", b"\n").replace(b"\r", b"\n").split(b"\n")
        )
        cells = self.lines[0].decode("utf-8", "replace").split(",")
        self.columns = tuple(cell.strip(' "\t') for cell in cells)
        self.may_be_json = self.text.lstrip()[:1] in (b"{", b"[")

    def has_suffix(self, *suffixes: str) -> bool:
        """Whether the file's name, without .gz, ends in one of these, in any case."""
        return self.path.name.lower().removesuffix(".gz").endswith(suffixes)

    @cached_property
    def hdf5(self) -> frozenset[str]:
        """The names of an HDF5 file's nodes and attributes, at the root and one below.

        `@name` is an attribute of the root, `group/name` and `group@name` are below. Of
        files of ours it is MARK alone; of damaged and of other files nothing.
        """
        if not self.bytes.startswith(HDF5_SIGNATURE):
            return frozenset()
        from shapefit.io.hdf5_file import as_text, open_hdf5

        try:
            with open_hdf5(self.path) as file:
                if str(as_text(file.attrs.get("format", ""))).startswith(MARK):
                    return frozenset({MARK})
                names = {*map(str, file), *(f"@{name}" for name in file.attrs)}
                for name, node in file.items():
                    names |= {
                        f"{name}@{attribute}"
                        for attribute in getattr(node, "attrs", ())
                    }
                    names |= {
                        f"{name}/{inner}" for inner in getattr(node, "keys", tuple)()
                    }
                return frozenset(names)
        except (
            Exception
        ):  # h5py has many kinds of error for damaged files: the reader names it
            return frozenset()

    @cached_property
    def json(self) -> object:
        """The content of a JSON file; None for other files, and damaged ones."""
        from shapefit.io.readers.text import read_json

        try:
            return read_json(self.path, keep=True) if self.may_be_json else None
        except InputError:
            return None

    @cached_property
    def keys(self) -> frozenset[str]:
        """The keys of a JSON object, or of the first objects in a list."""
        objects = self.json[:FIRST] if isinstance(self.json, list) else [self.json]
        return frozenset(
            key for entry in objects if isinstance(entry, dict) for key in entry
        )

    @cached_property
    def inner_keys(self) -> frozenset[str]:
        """The keys of the first objects in JSON, at up to MAX_LEVELS of nesting."""
        found: set[str] = set()
        level: list[object] = [self.json]
        for _ in range(MAX_LEVELS):
            within: list[object] = []
            for value in level:
                if isinstance(value, dict):
                    found |= value.keys()
                    within += islice(value.values(), FIRST)
                elif isinstance(value, list):
                    within += value[:FIRST]
            level = within[:MAX_VALUES_PER_LEVEL]
        return frozenset(found)


class FileFormat(NamedTuple):
    """A format of files: `title` with its article, and endings of names.

    records are the kinds that it can hold; `recognise` decides by a Head. read_poses,
    of formats of other tools, takes the paths that belong together: with `together` a
    folder, or its files, are one recording. `write` takes a path, the layout of the
    records, and OutputOptions, of use if it is `in_metres`: upright, a sequence a file;
    `angles` are written with it. states_y_axis: y points up or down in each of its
    files; either: a file may hold 2D and 3D, and read_poses takes which is wanted.
    json_keys are what its JSON has, for messages.
    """

    title: str
    suffixes: tuple[str, ...]
    records: tuple[str, ...] = ()
    recognise: Callable[[Head], bool] = lambda head: False
    read_poses: Callable[..., Poses] | None = None
    together: bool = False
    write: Callable[..., Output] | None = None
    in_metres: bool = False
    angles: bool = False
    states_y_axis: bool = True
    json_keys: tuple[str, ...] = ()
    either: bool = False


def _open_output(
    name: str, target: Path, layout: Layout, options: OutputOptions
) -> Output:
    """Return a context manager of a writer to `target`, in the format called `name`.

    Only the module of that format is imported.
    """
    if name == "hdf5":
        from shapefit.io.hdf5_output import hdf5_output

        return hdf5_output(target, layout)
    if name == "csv":
        from shapefit.io.csv_file import csv_output

        return csv_output(target)
    if name == "movement":
        from shapefit.io.writers.movement import movement_output

        return movement_output(target, options)
    if name == "calibration":
        from shapefit.io.writers.calibration import calibration_output

        return calibration_output(target, options)
    from shapefit.io.writers import bvh, motion, tables

    if name == "c3d":
        tables.load_ezc3d()
    writers = {
        "bvh": bvh.write_bvh,
        "c3d": tables.write_c3d,
        "trc": tables.write_trc,
        "mot": tables.write_mot,
        "metres": tables.write_metres,
        "angles": tables.write_angles,
    }
    judges = {
        "mot": tables.describe_angles_of_mot,
        "angles": tables.describe_uncertain_angles,
    }
    return motion.motion_output(
        target,
        options,
        writers[name],
        suffix=TARGETS[name].suffixes[0],
        unit="mm" if name == "c3d" else "m",
        angles=TARGETS[name].angles,
        judge_angles=judges.get(name),
    )


ITEMS = ("landmarks", "shapes", "result")
INDIVIDUALS = frozenset(
    [
        "individual",
        "person",
        "person_id",
        "track",
        "track_id",
        "animal",
        "subject",
        "id",
    ]
)
"""Columns of who is in an image, which tables of other tools have, and our CSV has not.
"""


def _is_our_csv(head: Head) -> bool:
    """Whether a file has the columns of shapefit's own tidy CSV, and no others.

    Tables with others are read as those of other tools.
    """
    from shapefit.io.csv_file import OPTIONAL_COLUMNS, without_row_numbers

    columns = {*without_row_numbers([*head.columns])}
    required = {"item", "landmark", "x", "y"}
    optional = {name for names in OPTIONAL_COLUMNS.values() for name in names}
    return required <= columns <= {*required, "z", *optional}


HDF5 = FileFormat(
    "an HDF5 file",
    (".h5", ".hdf5", ".hdf", ".he5"),
    (*ITEMS, "dictionary"),
    lambda head: MARK in head.hdf5,
    write=partial(_open_output, "hdf5"),
)
CSV = FileFormat(
    "a CSV file",
    (".csv",),
    ITEMS,
    lambda head: (
        not head.is_utf16 and not head.has_suffix(*HDF5.suffixes) and _is_our_csv(head)
    ),
    write=partial(_open_output, "csv"),
    states_y_axis=False,
)
OURS = {"hdf5": HDF5, "csv": CSV}

TARGETS = OURS | {
    name: FileFormat(
        title,
        (suffix,),
        ("shapes", "result"),
        write=partial(_open_output, name),
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
        ("movement", "a netCDF file of movement", ".nc"),
        ("calibration", "a TOML file of cameras", ".toml"),
    )
}
"""The formats that can be written, by their names."""

MESH_FORMATS = ("obj", "ply", "glb")
"""Those of meshes, of which `convert` writes a file an image into a folder; OBJ
keeps 8 decimals, PLY and GLB single precision.
"""


def our_format(path: Path) -> FileFormat | None:
    """Return HDF5 or CSV if a file is in a format of shapefit (`-` is CSV), or None."""
    if is_stream(path):
        return CSV
    if not path.is_file() or not os.access(path, os.R_OK):  # `require_file` says so
        return None
    head = Head(path)
    return next((row for row in OURS.values() if row.recognise(head)), None)


def find_format(name: str, formats: Mapping[str, FileFormat]) -> FileFormat:
    """Return the format of this name; InputError where there is none."""
    if name not in formats:
        fix = f"use auto, {listed(formats)}"
        raise input_error("format", f"there is no format {name!r}", fix)
    return formats[name]


def check_our_format(path: Path, kind: str, file_format: FileFormat) -> None:
    """Raise InputError unless a format is shapefit's own, and has records of `kind`.

    `path` is the file of that format, for the message.
    """
    if file_format.read_poses is not None or kind not in file_format.records:
        able = listed(row.title for row in OURS.values() if kind in row.records)
        fix = f"give a shapefit-{kind} file"
        raise input_error(source_name(path), f"is {file_format.title}, not {able}", fix)


def record_writer(
    target: Path, layout: Layout, to: str = "auto", options: OutputOptions = BY_DEFAULT
) -> Output:
    """Return a context manager of a writer of records to `target`, in the format `to`.

    Its `append` takes one or more. With `auto` the format is that of the name. The file
    replaces `target` on a clean exit and leaves nothing behind on an error.
    Raises InputError where that format cannot hold the records, or has no use for the
    options.
    """
    file_format = check_target_format(target, layout.kind, to)
    if is_stream(target) and file_format is not CSV:
        fault = "files of this format cannot go to standard output"
        raise input_error("output", fault, "name a file")
    given = options._asdict().items() - BY_DEFAULT._asdict().items()
    if given and not file_format.in_metres:
        fault = f"{file_format.title} keeps the unit and the axes of what is written"
        fix = "leave it out, or end the name in .metres.csv, .trc or .c3d"
        if file_format is CSV and layout is RESULTS and options.height is not None:
            fix += ", or in .h5, which states it"
        raise input_error(min(given)[0], fault, fix)
    assert file_format.write is not None
    return file_format.write(target, layout, options)


landmark_writer = partial(record_writer, layout=LANDMARKS)
result_writer = partial(record_writer, layout=RESULTS)


def find_target_format(path: Path, name: str = "auto") -> FileFormat:
    """Return the format to write, by the ending of a path or by the format's `name`.

    With `auto` it is CSV for `-`, and HDF5 for a name without ending. Raises InputError
    for an ending of no format, and unknown names.
    """
    if name in TARGETS:
        return TARGETS[name]
    if name != "auto":
        fix = f"use auto, {listed([*TARGETS, *MESH_FORMATS])}"
        raise input_error("to", f"there is no format {name!r}", fix)
    if is_stream(path):
        return CSV
    endings = {
        suffix: target for target in TARGETS.values() for suffix in target.suffixes
    }
    if fitting := [suffix for suffix in endings if path.name.lower().endswith(suffix)]:
        return endings[max(fitting, key=len)]
    if (mesh := path.suffix.lower().removeprefix(".")) in MESH_FORMATS:
        fix = "write the result in .h5, then"
        fix += f" `shapefit convert RESULT.h5 -d DICT.h5 -o meshes/ --to {mesh}`"
        raise input_error(path, "meshes go into a folder", fix)
    if path.suffix:
        fault = f"no format that is written ends in {path.suffix}"
        meshes = listed([name.upper() for name in MESH_FORMATS], "and")
        fix = f"end the name in {listed(endings)}; {meshes} are written into a folder,"
        fix += " by `shapefit convert --to`"
        raise input_error(path, fault, fix)
    return HDF5


def check_target_format(path: Path, kind: str, name: str = "auto") -> FileFormat:
    """Return the format to write; InputError if it cannot hold records of `kind`.

    The format is found as `find_target_format` finds it.
    """
    target = find_target_format(path, name)
    if kind not in target.records:
        what, fix = f"a {kind}", "give it a name in .h5"
        if kind == "landmarks":
            what, fix = (
                "2D landmarks",
                "lift them with `shapefit fit` first, or write .h5 or .csv",
            )
        raise input_error(path, f"{what} cannot be {target.title.split()[1]}", fix)
    return target
