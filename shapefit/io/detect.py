"""The table of formats that are read, and which of them a file is in, by its content."""

from __future__ import annotations

import os
import re
import zlib
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import cached_property, partial
from itertools import islice
from pathlib import Path
from typing import Any

from shapefit.errors import InputError, abbreviate, input_error, listed
from shapefit.io.formats import (
    CSV,
    HDF5,
    HEAD_BYTES,
    OWN,
    FileFormat,
    named_format,
    names_items,
    own_format,
)
from shapefit.io.inputs import (
    BYTE_ORDER_MARK,
    GZIP_SIGNATURE,
    HDF5_SIGNATURE,
    is_stream,
    read_head,
    require_file,
)
from shapefit.io.options import InputOptions
from shapefit.io.readers import deeplabcut, detections, markers, motion, tables, trackers
from shapefit.io.readers.text import decode, read_json
from shapefit.threads import on_threads

FIRST_FILES = 20
"""Of a folder that are looked at; entries of a JSON list, too."""

GZIP_BITS = 31
"""Of zlib, by which it reads what gzip wrote."""

CONTROL = frozenset(range(32)) - {*b"\t\n\v\f\r\x1a\x1b"}
"""Bytes that no text has."""

CALIBRATION = re.compile(rb"\b(?:camera_|intrinsic_)?matrix\"?\s*[=:]", re.IGNORECASE)
"""What a calibration has near its beginning, in TOML, YAML or JSON."""


def detect_format(path: Path, name: str = "auto") -> FileFormat:
    """Return the format of a file or folder, by what it begins with; text of no known kind is CSV.

    Standard input and pipes are CSV. With another `name` than auto it is that format. Raises
    InputError as `require_file` does, for unknown names, and for files that are something else.
    """
    if is_stream(path):
        return CSV
    if name != "auto":
        chosen = named_format(name, FORMATS)
        if path.is_dir() and not chosen.folders:
            problem = f"it is a folder, and {chosen.title} is a file"
            raise input_error(
                path, problem, f"name the files in it: '{path}/*{chosen.suffixes[0]}'"
            )
        return chosen
    if path.is_dir():
        return _detect_folder(path)
    require_file(path)
    if not path.is_file():
        return CSV
    if own := own_format(path):
        return own
    head = Head(path)
    if names_items(head.bytes) and not HDF5.has_suffix(path):  # of text that gzip made smaller
        return CSV
    for one in sorted(FORMATS.values(), key=lambda one: not one.has_suffix(path)):
        if one.recognise(head):
            return one
    if head.bytes.startswith(HDF5_SIGNATURE):
        return HDF5
    if HDF5.has_suffix(path) and not path.name.endswith(".gz"):
        fix = "give an HDF5 file, or name it .csv if it is CSV"
        raise input_error(path, "is not an HDF5 file", fix)
    _refuse_unknown(head)
    return CSV


def _detect_folder(path: Path) -> FileFormat:
    """Return the format of a folder whose files are one recording."""
    folders = [one for one in FORMATS.values() if one.folders]
    names = sorted(os.listdir(path))
    for one in folders:
        own = [path / name for name in names if name.lower().endswith(one.suffixes)]
        readable = (p for p in own[:FIRST_FILES] if p.is_file() and os.access(p, os.R_OK))
        if any(one.recognise(Head(file)) for file in readable):
            return one
    inner = [str(path / name) for name in names if (path / name).is_dir()]
    fix = f"name the files in it, e.g. '{path}/*.h5'"
    fix = f"name the folders in it: {abbreviate(inner, 3)}" if inner else fix
    kinds = listed(one.title for one in folders)
    raise input_error(path, f"it is a folder, and holds none of these: {kinds}", fix)


def _refuse_unknown(head: Head) -> None:
    """Raise InputError for a file of no format, unless it may be a table of text."""
    if CALIBRATION.search(head.text):
        problem = "is a calibration of cameras, not landmarks"
        raise input_error(head.path, problem, "give it as --calibration")
    if not _is_text(head.bytes):
        fix = "give the landmarks that a detector found in a video or images, not compressed"
        raise input_error(head.path, "is neither text nor of a known format", fix)
    if not head.may_be_json:
        return
    content = read_json(head.path)  # tells of damage
    first = content[0] if isinstance(content, list) and content else content
    keys = f"with {abbreviate(sorted(first))}" if isinstance(first, dict) else "without names"
    kind = "an object" if isinstance(content, dict) else "a list of objects"
    fix = (
        "give what OpenPose (version, people), AlphaPose, MMPose (instances) or MediaPipe write, "
        "COCO annotations (images, annotations, categories) or COCO results (image_id, keypoints)"
    )
    raise input_error(head.path, f"is JSON of no known kind, {kind} {keys}", fix)


def group_inputs(
    paths: Sequence[Path], options: InputOptions
) -> list[tuple[FileFormat, tuple[Path, ...]]]:
    """Return the inputs in order, each with its format; files that are one recording together."""
    groups: dict[tuple[str, str], tuple[FileFormat, list[Path]]] = {}
    formats = on_threads(partial(detect_format, name=options.format), paths)
    for path, one in zip(paths, formats, strict=True):
        shared = one.together and not path.is_dir()
        key = (one.title, str(path.parent)) if shared else ("", str(path))
        groups.setdefault(key, (one, []))[1].append(path)
    return [(one, tuple(own)) for one, own in groups.values()]


def warn_of_mixture(groups: Sequence[tuple[FileFormat, tuple[Path, ...]]]) -> tuple[str, ...]:
    """Warn of inputs in several formats, some of them of other tools, whose names may not agree."""
    counts = Counter(one.title for one, _ in groups)
    if len(counts) < 2 or all(one.read_poses is None for one, _ in groups):
        return ()
    kinds = listed((f"{title} ({number})" for title, number in counts.items()), "and")
    return (f"several formats in one call: {kinds}; landmarks are matched by their names",)


class Head:
    """What decides the format of a file; each part is looked at once."""

    def __init__(self, path: Path) -> None:
        """Read the first bytes. Raises what reading raises."""
        self.path, self.bytes = path, read_head(path, HEAD_BYTES)
        if self.bytes.startswith(GZIP_SIGNATURE):
            with suppress(zlib.error):
                text = zlib.decompressobj(GZIP_BITS).decompress(self.bytes, HEAD_BYTES)
                self.bytes = text if _is_text(text) else self.bytes
        self.text = self.bytes.removeprefix(BYTE_ORDER_MARK)
        self.lines = self.text.replace(b"\r\n", b"\n").replace(b"\r", b"\n").split(b"\n")
        cells = self.lines[0].decode("utf-8", "replace").split(",")
        self.columns = tuple(cell.strip(' "\t') for cell in cells)
        self.may_be_json = self.text.lstrip()[:1] in (b"{", b"[")

    def named(self, *endings: str) -> bool:
        """Whether the name of the file has one of these endings."""
        return self.path.name.lower().removesuffix(".gz").endswith(endings)

    @cached_property
    def hdf5(self) -> frozenset[str]:
        """The names in the root of an HDF5 file, and one level below; empty for damaged ones.

        `@name` is an attribute of the root, `group/name` and `group@name` are below.
        """
        from shapefit.io.hdf5_file import open_hdf5

        if not self.bytes.startswith(HDF5_SIGNATURE):
            return frozenset()
        try:
            with open_hdf5(self.path) as file:
                names = {*file, *(f"@{name}" for name in file.attrs)}
                for name in file:
                    node = file.get(name)
                    names |= {f"{name}@{attribute}" for attribute in getattr(node, "attrs", ())}
                    names |= {f"{name}/{inner}" for inner in getattr(node, "keys", tuple)()}
                return frozenset(name for name in names if isinstance(name, str))
        except Exception:  # h5py has many kinds of error for damaged files
            return frozenset()

    @cached_property
    def json(self) -> Any:
        """The content of a JSON file; None for other files, and damaged ones."""
        try:
            return read_json(self.path, keep=True) if self.may_be_json else None
        except InputError:
            return None

    @cached_property
    def json_format(self) -> str:
        """The name of the format that JSON is in, by its keys; empty for none."""
        if isinstance(self.json, dict):
            return _format_of_object(self.json)
        return _format_of_list(self.json) if isinstance(self.json, list) else ""


def _is_text(data: bytes) -> bool:
    """Whether bytes are the beginning of a text in UTF-8, UTF-16 with a mark, or Latin-1."""
    return data.startswith((b"\xff\xfe", b"\xfe\xff")) or not CONTROL & {*data}


def _format_of_object(content: dict[str, Any]) -> str:
    keys, people = content.keys(), {"people", "bodies"}
    first = next(iter(content.values()), None)
    if isinstance(first, dict) and people & first.keys():
        return "alphapose-json"  # each image as OpenPose writes it
    if {"images", "annotations", "categories", "licenses"} & keys or (
        "info" in keys and "people" not in keys
    ):
        return "coco-annotations"
    if {"meta_info", "instance_info"} & keys:
        return "mmpose-video"
    if people & keys or (keys and keys <= {"version", "part_candidates"}):
        return "openpose"  # and AlphaPose's `cmu`
    return _format_of_points(content, first)


def _format_of_list(content: list[Any]) -> str:
    objects = [entry for entry in content[:FIRST_FILES] if isinstance(entry, dict)]
    keys = {key for one in objects for key in one}
    points = objects[0].get("keypoints") if objects else None
    point = points[0] if isinstance(points, list) and points else None
    if objects and ({"image_id", "keypoints"} <= keys or isinstance(point, int | float)):
        return "coco-results"
    if "instances" in keys:
        return "mmpose-video"
    scored = "keypoint_scores" in keys or isinstance(point, list)
    if content == [] or ("keypoints" in keys and scored):
        return "mmpose-images"
    return _format_of_points(content, next(iter(content), None))


def _format_of_points(content: Any, frame: Any) -> str:
    """Return the format of JSON that has x and y of landmarks, by their names or in a list."""
    points = list(frame.values()) if isinstance(frame, dict) else []
    if points and all(map(_is_point, points)):
        return "named-points"
    return "mediapipe" if _has_points(content, 6) else ""


def _is_point(point: Any) -> bool:
    if isinstance(point, dict):
        return {"x", "y"} <= point.keys()
    numbers = isinstance(point, list) and len(point) in (2, 3)
    return numbers and all(isinstance(number, int | float | None) for number in point)


def _has_points(value: Any, depth: int) -> bool:
    if isinstance(value, dict):
        if {"x", "y"} <= value.keys():
            return next(iter(value)) in ("x", "name", "id")
        value = list(islice(value.values(), FIRST_FILES))
    within = value[:FIRST_FILES] if isinstance(value, list) and depth else []
    return any(_has_points(one, depth - 1) for one in within)


def is_deeplabcut_csv(head: Head) -> bool:
    """Whether the first cell is `scorer`, and one of the next lines begins `bodyparts`.

    A first line can be longer than what is seen of the file; then the first cell decides.
    """
    firsts = [line.split(b",", 1)[0].strip(b' "') for line in head.lines[:-1] or head.lines]
    if firsts[0] == b"scorer" and b"," in head.lines[0]:
        return len(firsts) < 3 or b"bodyparts" in firsts[1:3]
    return firsts[0] in (b"bodyparts", b"individuals") and b"coords" in firsts[1:3]


def is_vicon(head: Head) -> bool:
    """Whether a line says Trajectories, and its header follows."""
    firsts = [line.strip(b', "\t').lower() for line in head.lines]
    start = firsts.index(b"trajectories") + 3 if b"trajectories" in firsts else len(firsts)
    return any(line.startswith(b"frame,sub frame,") for line in firsts[start : start + 1])


def is_array(head: Head) -> bool:
    """Whether the file is NumPy's, or JSON of lists in a list."""
    first, depth = head.json if head.named(".json") else None, 0
    while isinstance(first, list) and first and depth < 3:
        first, depth = first[0], depth + 1
    lists = depth > 1 and isinstance(first, int | float | None)
    archive = head.bytes.startswith(b"PK\x03\x04") and head.named(".npz")
    return archive or lists or head.bytes.startswith(b"\x93NUMPY")


def is_yolo(head: Head) -> bool:
    """Whether a .txt file begins with a line of a class, a box and landmarks, all fractions."""
    cells = next((c for line in head.lines[:10] if (c := line.partition(b"#")[0].split())), [])
    try:
        first, *numbers = map(float, cells if head.named(".txt") else ())
    except ValueError:
        return False
    box, point = numbers[:4], numbers[4:6]
    placed = len(point) == 2 and all(-1 <= value <= 2 for value in point)
    return first.is_integer() and first >= 0 and placed and all(0 <= value <= 1 for value in box)


def is_table(head: Head) -> bool:
    """Whether the first line names columns of landmarks, in another layout than ours."""
    line = decode(head.bytes).replace("\r", "\n").partition("\n")[0]
    ours = {"item", "landmark"} <= {*head.columns}
    table = head.named(".csv", ".tsv", ".txt") and "\0" not in line and not ours
    return table and tables.parse_header(line) is not None


def is_acclaim(head: Head) -> bool:
    """Whether a file named so has a line of ASF or AMC."""
    lines = any(line.lstrip()[:1] in (b":", b"#") for line in head.lines)
    return head.named(".asf", ".amc") and b"\0" not in head.bytes and lines


Recogniser = Callable[[Head], bool]


def _json(name: str) -> Recogniser:
    return lambda head: head.json_format == name


def _columns(*names: str) -> Recogniser:
    return lambda head: {*names} <= {*head.columns}


def _hdf5(*names: str) -> Recogniser:
    """Return whether an HDF5 file has these names, see `Head.hdf5`."""
    return lambda head: {*names} <= head.hdf5


IMAGES, SHAPES, EITHER = ("landmarks",), ("shapes",), ("landmarks", "shapes")

# fmt: off
FORMATS: dict[str, FileFormat] = {
    **OWN,
    "deeplabcut-csv": FileFormat(
        "a DeepLabCut or Lightning Pose CSV", (".csv",), EITHER,
        is_deeplabcut_csv, deeplabcut.read_csv),
    "deeplabcut-h5": FileFormat(
        "a DeepLabCut HDF5 file", (".h5", ".hdf5"), EITHER,
        lambda head: any(name.endswith("@pandas_type") for name in head.hdf5),
        deeplabcut.read_hdf5),
    "jabs-h5": FileFormat(
        "a JABS pose file", (".h5",), IMAGES, _hdf5("poseest/points"), trackers.read_jabs),
    "movement-netcdf": FileFormat(
        "a movement netCDF file", (".nc", ".nc4"), EITHER, _hdf5("@ds_type"),
        trackers.read_movement),
    "nwb-ndx-pose": FileFormat(
        "an NWB file", (".nwb",), EITHER, _hdf5("@nwb_version"), trackers.read_nwb),
    "sleap-analysis-h5": FileFormat(
        "a SLEAP analysis file", (".h5", ".hdf5"), IMAGES, _hdf5("tracks", "node_names"),
        trackers.read_sleap_analysis),
    "sleap-slp": FileFormat(
        "a SLEAP .slp file", (".slp",), IMAGES,
        _hdf5("metadata@format_id", "frames", "instances"), trackers.read_slp),
    "alphapose-json": FileFormat(
        "an AlphaPose file of all images", (".json",), IMAGES, _json("alphapose-json"),
        detections.read_alphapose),
    "caliscope-csv": FileFormat(
        "a caliscope CSV", (".csv",), IMAGES,
        _columns("frame_index", "point_id", "img_loc_x", "img_loc_y"), tables.read_caliscope),
    "coco-annotations": FileFormat(
        "a file of COCO annotations", (".json",), IMAGES, _json("coco-annotations"),
        detections.read_coco_annotations),
    "coco-results": FileFormat(
        "a file of COCO results", (".json",), IMAGES, _json("coco-results"),
        detections.read_coco_results),
    "mmpose-images": FileFormat(
        "a set of MMPose files", (".json",), IMAGES, _json("mmpose-images"),
        detections.read_image_files, together=True, folders=True),
    "mmpose-video": FileFormat(
        "an MMPose file", (".json",), IMAGES, _json("mmpose-video"), detections.read_mmpose_video),
    "openpose": FileFormat(
        "a set of OpenPose files", (".json",), IMAGES, _json("openpose"),
        detections.read_image_files, together=True, folders=True),
    "ultralytics-txt": FileFormat(
        "a set of YOLO pose labels", (".txt",), IMAGES, is_yolo, detections.read_yolo,
        together=True, folders=True),
    "acclaim": FileFormat(
        "an ASF/AMC motion", (".amc", ".asf"), SHAPES, is_acclaim, motion.read_acclaim,
        together=True),
    "anipose-csv": FileFormat(
        "an anipose 3D CSV", (".csv",), SHAPES,
        lambda head: bool(markers.anipose_landmarks(head.columns)), markers.read_anipose),
    "bvh": FileFormat(
        "a BVH motion", (".bvh",), SHAPES,
        lambda head: head.text.upper().split(maxsplit=2)[:2] == [b"HIERARCHY", b"ROOT"],
        motion.read_bvh),
    "c3d": FileFormat(
        "a C3D file", (".c3d",), SHAPES,
        lambda head: head.named(".c3d") and head.bytes[1:2] == b"\x50", markers.read_c3d),
    "trc": FileFormat(
        "a TRC file", (".trc",), SHAPES,
        lambda head: head.text.lstrip()[:12].lower() == b"pathfiletype", markers.read_trc),
    "vicon-csv": FileFormat(
        "a Vicon Nexus CSV of trajectories", (".csv",), SHAPES, is_vicon, markers.read_vicon),
    "table": FileFormat(
        "a table of landmarks", (".csv", ".tsv", ".txt"), EITHER, is_table, tables.read_any_table,
        states_y_axis=False),
    "arrays": FileFormat(
        "an array of landmarks", (".npy", ".npz"), IMAGES, is_array, tables.read_array,
        states_y_axis=False),
    "named-points": FileFormat(
        "JSON of points by frame and landmark", (".json",), IMAGES, _json("named-points"),
        detections.read_named_points),
    "mediapipe": FileFormat(
        "a file of MediaPipe's landmarks", (".json",), IMAGES, _json("mediapipe"),
        detections.read_mediapipe),
}
# fmt: on
"""Those of the package come first; the others are asked in this order."""
