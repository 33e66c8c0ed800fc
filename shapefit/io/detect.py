"""The table of formats that are read, and which of them a file is in, by its
content.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Sequence
from itertools import islice
from pathlib import Path
from typing import Any

from shapefit.errors import abbreviate, input_error, listed
from shapefit.io.formats import (
    CSV,
    FIRST,
    HDF5,
    OURS,
    FileFormat,
    Head,
    named_format,
    our_format,
)
from shapefit.io.inputs import HDF5_SIGNATURE, is_stream, require_file
from shapefit.io.options import InputOptions
from shapefit.io.readers import (
    arrays,
    deeplabcut,
    detections,
    markers,
    morphometrics,
    motion,
    tables,
    trackers,
)
from shapefit.io.readers.headers import parse_header
from shapefit.io.readers.text import decode, read_json
from shapefit.io.unread import name_unread

CONTROL = frozenset(range(32)) - {*b"\t\n\v\f\r\x1a\x1b"}
"""Bytes that no text has."""

CALIBRATION = re.compile(rb"\b(?:camera_|intrinsic_)?matrix\"?\s*[=:]", re.IGNORECASE)
"""What a calibration has near its beginning, in TOML, YAML or JSON."""


def detect_format(path: Path, name: str = "auto") -> FileFormat:
    """Return the format of a file or folder, by what it begins with; text of no known
    kind is CSV.

    Standard input and pipes are CSV. With another `name` than auto it is that format.
    Raises InputError as `require_file` does, for unknown names, and for files that are
    something else.
    """
    if name != "auto" and not is_stream(path):
        chosen = named_format(name, FORMATS)
        if path.is_dir() and not chosen.together:
            fix = f"name the files in it: '{path}/*{chosen.suffixes[0]}'"
            raise input_error(
                path, f"it is a folder, and {chosen.title} is a file", fix
            )
        return chosen
    if path.is_dir():
        return _detect_folder(path)
    if (ours := our_format(path)) is not None:
        return ours
    require_file(path)
    if not path.is_file():
        return CSV
    head = Head(path)
    for one in FORMATS.values():
        if one.recognise(head):
            return one
    if (unread := name_unread(path, head)) is not None:
        raise unread
    if head.bytes.startswith(HDF5_SIGNATURE):
        return HDF5
    if head.named(*HDF5.suffixes):
        fix = "give an HDF5 file, or name it .csv if it is CSV"
        raise input_error(path, "is not an HDF5 file", fix)
    if CALIBRATION.search(head.text):
        fault = "is a calibration of cameras, not landmarks"
        raise input_error(path, fault, "give it as --calibration")
    if CONTROL & {*head.bytes} and not head.bytes.startswith(
        (b"\xff\xfe", b"\xfe\xff")
    ):
        fix = (
            "give the landmarks that a detector found in a video or images, not"
            " compressed"
        )
        raise input_error(path, "is neither text nor of a known format", fix)
    if head.may_be_json:
        read_json(path)  # names the line of damage
        keys = f"with {abbreviate(sorted(head.keys))}" if head.keys else "without names"
        fix = (
            "give JSON of OpenPose, AlphaPose, MMPose, MediaPipe or COCO"
            " (docs/formats.md)"
        )
        raise input_error(path, f"is JSON of no known kind, {keys}", fix)
    return CSV


def _detect_folder(path: Path) -> FileFormat:
    """Return the format of a folder whose files are one recording."""
    names = sorted(os.listdir(path))
    folders = [one for one in FORMATS.values() if one.together]
    for one in folders:
        files = [path / name for name in names if name.lower().endswith(one.suffixes)]
        if any(file.is_file() and one.recognise(Head(file)) for file in files[:FIRST]):
            return one
    kinds = listed(one.title for one in folders)
    fix = "name the files in it, or a folder of such files"
    raise input_error(path, f"it is a folder, and holds none of these: {kinds}", fix)


def group_inputs(
    paths: Sequence[Path], options: InputOptions
) -> list[tuple[FileFormat, tuple[Path, ...]]]:
    """Return the inputs in order, each with its format; files that are one recording
    together.
    """
    groups: dict[tuple[str, Path], tuple[FileFormat, list[Path]]] = {}
    for path in paths:
        one = detect_format(path, options.format)
        shared = one.together and not path.is_dir()
        key = (one.title, path.parent) if shared else ("", path)
        groups.setdefault(key, (one, []))[1].append(path)
    return [(one, tuple(files)) for one, files in groups.values()]


def is_yolo(head: Head) -> bool:
    """Whether a .txt file begins with a line of a class, a box and landmarks, all
    fractions.
    """
    try:
        rows = (
            line for line in head.lines if line.strip() and not line.startswith(b"#")
        )
        first, *numbers = map(
            float, next(rows, b"").split() if head.named(".txt") else ()
        )
    except ValueError:
        return False
    box, point = numbers[:4], numbers[4:6]
    placed = len(point) == 2 and all(-1 <= value <= 2 for value in point)
    return (
        first.is_integer()
        and first >= 0
        and placed
        and all(0 <= value <= 1 for value in box)
    )


def is_deeplabcut_csv(head: Head) -> bool:
    """Whether its rows of names come first; what is seen of the file can end in one of
    them.
    """
    lines = [decode(line) for line in head.lines[:3]]
    first, *others = deeplabcut.row_names(lines)
    if first == "scorer" and len(lines[0]) > len("scorer"):
        return len(others) < 2 or "bodyparts" in others
    return first in ("bodyparts", "individuals") and "coords" in others


def is_table(head: Head) -> bool:
    """Whether the first line names columns of landmarks."""
    text = decode(head.text).replace("\r\n", "\n").replace("\r", "\n")
    first = "\n".join(text.split("\n", 2)[:2])
    table = head.named(".csv", ".tsv", ".txt") and "\0" not in first
    return table and parse_header(text) is not None


def is_array(head: Head) -> bool:
    """Whether the file is NumPy's, or JSON of lists in a list."""
    lists = isinstance(head.json, list) and isinstance(
        next(iter(head.json), None), list
    )
    archive = head.bytes.startswith(b"PK\x03\x04") and head.named(".npz")
    return archive or lists or head.bytes.startswith(b"\x93NUMPY")


def is_mmpose_images(head: Head) -> bool:
    """Whether a list, which may be empty, has instances of one image."""
    named = "keypoints" in head.keys and "image_id" not in head.keys
    return isinstance(head.json, list) and (named or not head.json)


def _has_points(value: Any, depth: int = 6) -> bool:
    """Whether objects that begin with x, or a name, and have y are somewhere in
    JSON.
    """
    if isinstance(value, dict):
        if {"x", "y"} <= value.keys():
            return next(iter(value)) in ("x", "name", "id")
        value = list(islice(value.values(), FIRST))
    within = value[:FIRST] if isinstance(value, list) and depth else []
    return any(_has_points(one, depth - 1) for one in within)


def _hdf5(*names: str) -> Callable[[Head], bool]:
    """Return whether an HDF5 file has all these names, see `Head.hdf5`."""
    return lambda head: {*names} <= head.hdf5


def _json(kind: type, *keys: str) -> Callable[[Head], bool]:
    """Return whether JSON is of a type and has one of these keys, see `Head.keys`."""
    return lambda head: isinstance(head.json, kind) and bool(head.keys & {*keys})


IMAGES, SHAPES, EITHER = ("landmarks",), ("shapes",), ("landmarks", "shapes")
H5, JSON, TABLE = (".h5", ".hdf5"), (".json",), (".csv",)

FORMATS: dict[str, FileFormat] = {
    **OURS,
    "deeplabcut-csv": FileFormat(
        "a DeepLabCut or Lightning Pose CSV",
        TABLE,
        EITHER,
        is_deeplabcut_csv,
        deeplabcut.read_csv,
    ),
    "deeplabcut-h5": FileFormat(
        "a DeepLabCut HDF5 file",
        H5,
        EITHER,
        lambda head: any(name.endswith("@pandas_type") for name in head.hdf5),
        deeplabcut.read_hdf5,
    ),
    "jabs-h5": FileFormat(
        "a JABS pose file", H5, IMAGES, _hdf5("poseest/points"), trackers.read_jabs
    ),
    "movement-netcdf": FileFormat(
        "a movement netCDF file",
        (".nc", ".nc4"),
        EITHER,
        _hdf5("@ds_type"),
        trackers.read_movement,
    ),
    "nwb-ndx-pose": FileFormat(
        "an NWB file", (".nwb",), EITHER, _hdf5("@nwb_version"), trackers.read_nwb
    ),
    "sleap-analysis-h5": FileFormat(
        "a SLEAP analysis file",
        H5,
        IMAGES,
        _hdf5("tracks", "node_names"),
        trackers.read_sleap_analysis,
    ),
    "sleap-slp": FileFormat(
        "a SLEAP .slp file",
        (".slp",),
        IMAGES,
        _hdf5("metadata@format_id", "frames", "instances"),
        trackers.read_slp,
    ),
    "caliscope-csv": FileFormat(
        "a caliscope CSV",
        TABLE,
        IMAGES,
        lambda head: (
            {"frame_index", "point_id", "img_loc_x", "img_loc_y"} <= {*head.columns}
        ),
        tables.read_caliscope,
    ),
    "coco-annotations": FileFormat(
        "a file of COCO annotations",
        JSON,
        IMAGES,
        _json(dict, "images", "annotations", "categories"),
        detections.read_coco_annotations,
    ),
    "coco-results": FileFormat(
        "a file of COCO results",
        JSON,
        IMAGES,
        _json(list, "image_id"),
        detections.read_coco_results,
    ),
    "mmpose-video": FileFormat(
        "an MMPose file",
        JSON,
        IMAGES,
        _json(object, "instances", "instance_info", "meta_info"),
        detections.read_mmpose_video,
    ),
    "mmpose-images": FileFormat(
        "a set of MMPose files",
        JSON,
        IMAGES,
        is_mmpose_images,
        detections.read_image_files,
        together=True,
    ),
    "openpose": FileFormat(
        "a set of OpenPose files",
        JSON,
        IMAGES,
        _json(dict, "people", "version"),
        detections.read_image_files,
        together=True,
    ),
    "ultralytics-txt": FileFormat(
        "a set of YOLO pose labels",
        (".txt",),
        IMAGES,
        is_yolo,
        detections.read_yolo,
        together=True,
    ),
    "tps": FileFormat(
        "a TPS file",
        (".tps",),
        EITHER,
        lambda head: morphometrics.TPS.match(head.text) is not None,
        morphometrics.read_tps,
    ),
    "pts": FileFormat(
        "a set of .pts files",
        (".pts",),
        IMAGES,
        lambda head: morphometrics.PTS.match(head.text) is not None,
        morphometrics.read_pts,
        together=True,
    ),
    "acclaim": FileFormat(
        "an ASF/AMC motion",
        (".amc", ".asf"),
        SHAPES,
        lambda head: (
            head.named(".asf", ".amc") and head.text.lstrip()[:1] in (b":", b"#")
        ),
        motion.read_acclaim,
    ),
    "anipose-csv": FileFormat(
        "an anipose 3D CSV",
        TABLE,
        SHAPES,
        lambda head: any(name.endswith("_ncams") for name in head.columns),
        tables.read_any_table,
    ),
    "bvh": FileFormat(
        "a BVH motion",
        (".bvh",),
        SHAPES,
        lambda head: head.text.upper().split(maxsplit=2)[:2] == [b"HIERARCHY", b"ROOT"],
        motion.read_bvh,
    ),
    "c3d": FileFormat(
        "a C3D file",
        (".c3d",),
        SHAPES,
        lambda head: head.named(".c3d") and head.bytes[1:2] == b"\x50",
        markers.read_c3d,
    ),
    "trc": FileFormat(
        "a TRC file",
        (".trc",),
        SHAPES,
        lambda head: head.text.lstrip()[:12].lower() == b"pathfiletype",
        markers.read_trc,
    ),
    "vicon-csv": FileFormat(
        "a Vicon Nexus CSV of trajectories",
        TABLE,
        SHAPES,
        lambda head: (
            b"frame,sub frame," in head.text.lower().partition(b"trajectories")[2]
        ),
        markers.read_vicon,
    ),
    "table": FileFormat(
        "a table of landmarks",
        (".csv", ".tsv", ".txt"),
        EITHER,
        is_table,
        tables.read_any_table,
        states_y_axis=False,
        either=True,
    ),
    "mediapipe": FileFormat(
        "a file of MediaPipe's landmarks",
        JSON,
        IMAGES,
        lambda head: _has_points(head.json),
        detections.read_mediapipe,
    ),
    "arrays": FileFormat(
        "an array of landmarks",
        (".npy", ".npz"),
        EITHER,
        is_array,
        arrays.read_array,
        states_y_axis=False,
        either=True,
    ),
    "arrays-3d": FileFormat(
        "an array of 3D points",
        (".npy", ".npz"),
        SHAPES,
        lambda head: False,
        arrays.read_shapes,
    ),
}
"""Those of the package come first; the others are asked in this order."""
