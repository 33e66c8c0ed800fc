"""Files that people have and that are not read: what they are, and what to give.

Formats that are read are in `io/detect.py`, which asks here last.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from shapefit.errors import InputError, abbreviate, input_error, printable
from shapefit.io.formats import Head


class Unread(NamedTuple):
    """A kind of file that is not read: its title, and what to give in its place."""

    title: str
    fix: str
    recognise: Callable[[Head], bool]


def unread_error(path: Path, head: Head) -> InputError | None:
    """Return the InputError for a file of a known format that is not read, or None."""
    kind = next((one for one in UNREAD if one.recognise(head)), None)
    if kind is None:
        return None
    json = f"{describe_json(head)}: " if head.json is not None else "is "
    return input_error(path, f"{json}{kind.title}, which is not read", kind.fix)


def describe_json(head: Head) -> str:
    """Describe JSON of no known kind by its keys, for a message."""
    keys = f"with {abbreviate(sorted(head.keys))}" if head.keys else "without names"
    return f"is JSON of no known kind, {printable(keys)}"


def _recognise_by_keys(*keys: str) -> Callable[[Head], bool]:
    """Make a function of a Head: is it JSON with all these keys near its beginning?"""
    return lambda head: head.json is not None and {*keys} <= head.inner_keys


def _recognise_by_beginning(*beginnings: bytes) -> Callable[[Head], bool]:
    """Make a function of a Head: does it begin with one of these, in any case?"""
    lower = tuple(one.lower() for one in beginnings)
    return lambda head: head.text.lstrip().lower().startswith(lower)


def _recognise_by_suffix(
    *endings: str, begins: tuple[bytes, ...] = (b"",)
) -> Callable[[Head], bool]:
    """Make a function of a Head: has it one of `endings`, and a start of `begins`?"""
    return lambda head: head.has_suffix(*endings) and head.bytes.startswith(begins)


def _recognise_by_lines(*patterns: str) -> Callable[[Head], bool]:
    """Make a function of a Head: has its text a line that matches each pattern?"""
    rows = [re.compile(one.encode(), re.MULTILINE | re.IGNORECASE) for one in patterns]
    return lambda head: all(row.search(head.text) for row in rows)


SHAPES_OF_MESH = (
    "take its landmarks from the vertices and write shapes, as docs/cars.md shows"
)
AS_TABLE = "write a table of item, landmark, x, y (and z), see docs/formats.md"
AS_CSV = "save it as CSV"
AS_COCO = "export it as COCO keypoints"
OF_MATLAB = "load it with SciPy, as docs/from_matlab.md shows"

UNREAD = (
    Unread(
        "a motion of joint angles (MOT or STO)",
        "give its markers: TRC or C3D",
        _recognise_by_lines(r"^\W*(?:n|data)Rows[ =]", r"^\W*(?:n|data)Columns[ =]"),
    ),
    Unread(
        "a CSV of OptiTrack Motive",
        "export the markers as TRC or C3D",
        _recognise_by_lines(r"^\W*Format Version,.*Take Name"),
    ),
    Unread(
        "a TSV of Qualisys Track Manager",
        "export C3D or TRC",
        _recognise_by_beginning(b"NO_OF_FRAMES\t", b"NO_OF_FRAMES,"),
    ),
    Unread(
        "a MATLAB file",
        OF_MATLAB,
        lambda head: head.has_suffix(".mat") or head.bytes.startswith(b"MATLAB "),
    ),
    Unread(
        "a file of NTSYS (NTS)",
        AS_TABLE,
        _recognise_by_lines(r"^ *[1-9] +\d+[LB]? +\d+[LB]? +[01].*\bDIM *= *\d"),
    ),
    Unread(
        "a file of Morphologika", AS_TABLE, _recognise_by_lines(r"^\[individuals\]")
    ),
    Unread(
        "a file of markups of 3D Slicer",
        "save it as a table of label, x, y, z, and add a column item",
        lambda head: b"# Markups fiducial file" in head.text or "markups" in head.keys,
    ),
    Unread("a file of LabelMe", AS_COCO, _recognise_by_keys("shapes", "imagePath")),
    Unread(
        "a file of Label Studio",
        AS_COCO,
        _recognise_by_keys("from_name", "to_name", "value"),
    ),
    Unread(
        "a file of SLEAP", "save it as .slp", _recognise_by_keys("skeletons", "labels")
    ),
    Unread(
        "a file of CMU Panoptic",
        "its points are 3D: write them as a table item,landmark,x,y,z",
        _recognise_by_keys("bodies", "univTime"),
    ),
    Unread(
        "a file of AlphaPose for CMU",
        "write it with --format coco or open",
        _recognise_by_keys("bodies", "joints"),
    ),
    Unread(
        "a file of IDAV Landmark",
        AS_TABLE,
        _recognise_by_suffix(".pts", ".dta", begins=(b"Version ",)),
    ),
    Unread("a mesh (PLY)", SHAPES_OF_MESH, _recognise_by_beginning(b"ply\n", b"ply\r")),
    Unread("a mesh (glTF)", SHAPES_OF_MESH, _recognise_by_suffix(".glb", ".gltf")),
    Unread("a mesh (STL)", SHAPES_OF_MESH, _recognise_by_suffix(".stl")),
    Unread(
        "a mesh (OBJ)",
        SHAPES_OF_MESH,
        lambda head: head.has_suffix(".obj") and b"v " in head.text,
    ),
    Unread("a mesh (OFF)", SHAPES_OF_MESH, _recognise_by_suffix(".off")),
    Unread("an FBX file", "export BVH", _recognise_by_suffix(".fbx")),
    Unread(
        "a motion of Xsens (MVNX)", "export C3D or BVH", _recognise_by_lines(r"<mvnx\b")
    ),
    Unread(
        "the description of a dataset of Ultralytics",
        "give the folder of its labels",
        _recognise_by_lines(r"^kpt_shape *:"),
    ),
    Unread("XML of CVAT", AS_COCO, _recognise_by_lines(r"<annotations>", r"<meta>")),
    Unread("XML", AS_TABLE, _recognise_by_beginning(b"<?xml", b"\xef\xbb\xbf<?xml")),
    Unread(
        "a spreadsheet",
        AS_CSV,
        _recognise_by_suffix(".xlsx", ".xlsm", ".xls", ".ods", ".numbers"),
    ),
    Unread("a Parquet file", AS_CSV, _recognise_by_beginning(b"PAR1")),
    Unread(
        "a pickle, which could run programs",
        "save arrays with numpy.save, tables as CSV or HDF5",
        _recognise_by_suffix(".pkl", ".pickle"),
    ),
    Unread(
        "a file of R",
        "write a table with write.csv",
        _recognise_by_suffix(".rds", ".rdata", ".rda"),
    ),
)
