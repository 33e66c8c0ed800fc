"""What kind of file this is, by its content: first bytes, lines and columns, keys of JSON and HDF5.

`is_...` take a `Head` and say whether it is of a format; `io/formats.py` asks them in its order.
"""

from __future__ import annotations

import os
import re
import struct
import zlib
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import cached_property
from itertools import islice
from pathlib import Path
from typing import Any

from shapefit.errors import InputError, abbreviate, input_error
from shapefit.io.inputs import (
    BYTE_ORDER_MARK,
    GZIP_SIGNATURE,
    HDF5_SIGNATURE,
    read_head,
)
from shapefit.io.readers.columns import anipose_landmarks, decode, parse_header
from shapefit.io.readers.json_file import read_json

HEAD_BYTES = 4096
"""Of a file that decide its format, where it is neither JSON nor HDF5."""

OWN_FORMAT = "shapefit-"
"""What the root attribute `format` of our own HDF5 files begins with."""

FIRST_FILES = 20
"""Of a folder that are looked at; entries of a JSON list, too."""


class Head:
    """What decides the format of a file, or of a folder; each part is looked at once."""

    def __init__(self, path: Path) -> None:
        """Read the first bytes; those of a folder are none. Raises what reading raises."""
        self.path = path
        self.is_folder = path.is_dir()
        self.bytes = b"" if self.is_folder else read_head(path, HEAD_BYTES)
        if self.bytes.startswith(GZIP_SIGNATURE):
            self.bytes = _unpacked(self.bytes) or self.bytes

    def named(self, *endings: str) -> bool:
        """Whether the name of the file has one of these endings."""
        return self.path.name.lower().removesuffix(".gz").endswith(endings)

    @cached_property
    def text(self) -> bytes:
        """The first bytes without the mark that text in UTF-8 may begin with."""
        return self.bytes.removeprefix(BYTE_ORDER_MARK)

    @cached_property
    def lines(self) -> list[bytes]:
        """The first lines, whatever ends them; the last may be cut."""
        return self.text.replace(b"\r\n", b"\n").replace(b"\r", b"\n").split(b"\n")

    @cached_property
    def columns(self) -> frozenset[str]:
        """The cells of the first line, split at commas, without spaces and quotes."""
        cells = self.lines[0].decode("utf-8", "replace").split(",")
        return frozenset(cell.strip(' "\t') for cell in cells)

    @property
    def may_be_json(self) -> bool:
        """Whether the file begins as JSON does."""
        return self.text.lstrip()[:1] in (b"{", b"[")

    @cached_property
    def json(self) -> Any:
        """The content of a JSON file; None for other files, and damaged ones."""
        try:
            return read_json(self.path, keep=True) if self.may_be_json else None
        except InputError:
            return None

    @cached_property
    def keys(self) -> frozenset[str]:
        """The keys of a JSON object, or those of the first objects in a JSON list."""
        objects = [self.json] if isinstance(self.json, dict) else self.objects
        return frozenset(key for each in objects for key in each)

    @property
    def objects(self) -> list[dict[str, Any]]:
        """The first objects in a JSON list."""
        entries = self.json[:FIRST_FILES] if isinstance(self.json, list) else []
        return [each for each in entries if isinstance(each, dict)]

    @cached_property
    def hdf5(self) -> frozenset[str]:
        """The names in the root of an HDF5 file of another tool, and one level below.

        `@name` is an attribute of the root, `group/name` and `group@name` are below. Empty for our
        own files, and for damaged ones, which their reader names.
        """
        from shapefit.io.hdf5_file import as_text, open_hdf5

        if not self.bytes.startswith(HDF5_SIGNATURE):
            return frozenset()
        try:
            with open_hdf5(self.path) as file:
                if str(as_text(file.attrs.get("format", ""))).startswith(OWN_FORMAT):
                    return frozenset()
                names = {*file, *(f"@{name}" for name in file.attrs)}
                for name in file:
                    node = file.get(name)
                    names |= {f"{name}@{each}" for each in getattr(node, "attrs", ())}
                    names |= {f"{name}/{each}" for each in getattr(node, "keys", tuple)()}
                return frozenset(name for name in names if isinstance(name, str))
        except Exception:  # h5py has many kinds of error for damaged files
            return frozenset()

    def files(self, ending: str) -> Iterator[Head]:
        """Yield the heads of the first files of a folder with this ending, by name."""
        names = sorted(name for name in os.listdir(self.path) if name.lower().endswith(ending))
        for name in names[:FIRST_FILES]:
            path = self.path / name
            if path.is_file() and os.access(path, os.R_OK):
                yield Head(path)


GZIP_BITS = 31
"""Of zlib, by which it reads what gzip wrote."""


def _unpacked(packed: bytes) -> bytes:
    """Return the first bytes of a text that gzip made smaller; none where it is no text."""
    with suppress(zlib.error):
        head = zlib.decompressobj(GZIP_BITS).decompress(packed, HEAD_BYTES)
        return head if _is_text(head) else b""
    return b""


Recogniser = Callable[[Head], bool]


def in_folder(ending: str, recogniser: Recogniser) -> Recogniser:
    """Return whether a file is of a format, or one of the first in a folder is."""

    def any_is(head: Head) -> bool:
        return any(map(recogniser, head.files(ending) if head.is_folder else [head]))

    return any_is


def has_hdf5(*names: str) -> Recogniser:
    """Return whether HDF5 of another tool has all of these names, see `Head.hdf5`."""
    return lambda head: head.hdf5.issuperset(names)


def is_pandas(head: Head) -> bool:
    """Whether pandas wrote a table into an HDF5 file."""
    return any(name.endswith("@pandas_type") for name in head.hdf5)


def is_nwb(head: Head) -> bool:
    """Whether HDF5 says that it is NWB, or has its groups."""
    return "@nwb_version" in head.hdf5 or any(n.startswith("processing/") for n in head.hdf5)


def is_deeplabcut_csv(head: Head) -> bool:
    """Whether the first cell is `scorer`, and one of the next lines begins `bodyparts`.

    A first line can be longer than what is seen of the file; then the first cell decides.
    """
    lines = head.lines[:-1] or head.lines
    firsts = [line.split(b",", 1)[0].strip(b' "') for line in lines]
    if firsts[0] == b"scorer" and b"," in head.lines[0]:
        return len(firsts) < 3 or b"bodyparts" in firsts[1:3]
    return firsts[0] in (b"bodyparts", b"individuals") and b"coords" in firsts[1:3]


def is_caliscope(head: Head) -> bool:
    """Whether columns are those of caliscope's points in images."""
    needed = {"frame_index", "point_id", "img_loc_x", "img_loc_y"}
    return needed <= head.columns and bool(head.columns & {"port", "cam_id"})


def is_openpose(head: Head) -> bool:
    """Whether an object has OpenPose's keys, which AlphaPose's `cmu` has, too."""
    bare = bool(head.keys) and head.keys <= {"version", "part_candidates"}
    return isinstance(head.json, dict) and (bare or bool(head.keys & {"people", "bodies"}))


def is_alphapose(head: Head) -> bool:
    """Whether the values of an object are what OpenPose writes of an image."""
    first = next(iter(head.json.values()), None) if isinstance(head.json, dict) else None
    return isinstance(first, dict) and bool({"people", "bodies"} & first.keys())


def is_coco_results(head: Head) -> bool:
    """Whether a list has objects of an image and keypoints, or of numbers in one list."""
    with_image = {"image_id", "keypoints"} <= head.keys
    return bool(head.objects) and (with_image or isinstance(_first_keypoint(head), int | float))


def is_mmpose_images(head: Head) -> bool:
    """Whether a list has objects of [x, y] and scores, or nothing."""
    paired = "keypoint_scores" in head.keys or isinstance(_first_keypoint(head), list)
    points = bool(head.objects) and "keypoints" in head.keys and "instances" not in head.keys
    return head.json == [] or (points and paired)


def _first_keypoint(head: Head) -> Any:
    """Return what the list `keypoints` of the first object begins with."""
    points = head.objects[0].get("keypoints") if head.objects else None
    return points[0] if isinstance(points, list) and points else None


def is_mmpose_video(head: Head) -> bool:
    """Whether an object has the instances of a video, or a list the frames with them."""
    wanted = {"instances"} if isinstance(head.json, list) else {"meta_info", "instance_info"}
    return bool(head.keys & wanted)


def is_coco_annotations(head: Head) -> bool:
    """Whether an object has images and annotations."""
    parts = {"images", "annotations", "categories", "licenses"}
    alone = "info" in head.keys and "people" not in head.keys
    return isinstance(head.json, dict) and (alone or bool(head.keys & parts))


def is_mediapipe(head: Head) -> bool:
    """Whether JSON begins with objects of x and y."""

    def has_points(value: Any, depth: int) -> bool:
        if isinstance(value, dict):
            if {"x", "y"} <= value.keys():
                return next(iter(value)) in ("x", "name", "id")
            value = list(islice(value.values(), FIRST_FILES))
        within = value[:FIRST_FILES] if isinstance(value, list) and depth else []
        return any(has_points(each, depth - 1) for each in within)

    return has_points(head.json, 6)


def is_named_points(head: Head) -> bool:
    """Whether JSON has frames, and each of them points by the names of landmarks."""
    frames = head.json.values() if isinstance(head.json, dict) else head.json
    frame = next(iter(frames), None) if isinstance(head.json, dict | list) else None
    points = list(frame.values()) if isinstance(frame, dict) else []
    return bool(points) and all(
        {"x", "y"} <= point.keys()
        if isinstance(point, dict)
        else isinstance(point, list)
        and len(point) in (2, 3)
        and all(isinstance(number, int | float | None) for number in point)
        for point in points
    )


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
        first, *numbers = map(float, cells)
    except ValueError:
        return False
    box, point = numbers[:4], numbers[4:6]
    placed = len(point) == 2 and all(-1 <= value <= 2 for value in point)
    fractions = all(0 <= value <= 1 for value in box)
    return head.named(".txt") and first.is_integer() and first >= 0 and placed and fractions


def is_anipose(head: Head) -> bool:
    """Whether columns are those of anipose's points in space."""
    return bool(anipose_landmarks(head.columns))


def is_table(head: Head) -> bool:
    """Whether the first line names columns of landmarks, in another layout than ours."""
    if not head.named(".csv", ".tsv", ".txt") or is_anipose(head):
        return False
    line = decode(head.bytes).replace("\r", "\n").partition("\n")[0]
    ours = {"item", "landmark"} <= {cell.strip(' "\t') for cell in line.split(",")}
    return "\0" not in line and not ours and parse_header(line) is not None


def is_acclaim(head: Head) -> bool:
    """Whether a file named so has a line of ASF or AMC."""
    lines = any(line.lstrip()[:1] in (b":", b"#") for line in head.lines)
    return head.named(".asf", ".amc") and b"\0" not in head.bytes and lines


def is_bvh(head: Head) -> bool:
    """Whether a text begins HIERARCHY ROOT."""
    words = head.text.split(maxsplit=2)
    return [word.upper() for word in words[:2]] == [b"HIERARCHY", b"ROOT"]


def is_trc(head: Head) -> bool:
    """Whether a text begins PathFileType."""
    return head.text.lstrip()[:12].lower() == b"pathfiletype"


C3D_BLOCK, C3D_MAGIC = 512, 0x50
"""Bytes of the header of C3D, and its second byte."""


def is_c3d(head: Head) -> bool:
    """Whether a file begins with the place of its parameters, 0x50, and numbers that agree."""
    data = head.bytes
    if len(data) < C3D_BLOCK or data[1] != C3D_MAGIC or data[0] == 0:
        return False
    points, _, first, last = struct.unpack("<HHHH", data[2:10])
    start = struct.unpack("<H", data[16:18])[0]
    agree = 0 < points < 1024 and 0 < first <= last and 1 < start < 1024 and data[0] < 8
    return head.named(".c3d") or agree


# Files of no format.

CALIBRATION = re.compile(rb"\b(?:camera_|intrinsic_)?matrix\"?\s*[=:]", re.IGNORECASE)
"""What a calibration has near its beginning, in TOML, YAML or JSON."""


def refuse_unknown(head: Head) -> None:
    """Raise InputError for a file of no format, unless it may be a table of text."""
    if CALIBRATION.search(head.text):
        found = "is a calibration of cameras, not landmarks"
        raise input_error(head.path, found, "give it as --calibration")
    if not _is_text(head.bytes):
        fix = "give the landmarks that a detector found in a video or images, not compressed"
        raise input_error(head.path, "is neither text nor of a known format", fix)
    if not head.may_be_json:
        return
    read_json(head.path)  # tells of damage
    place = "an object" if isinstance(head.json, dict) else "a list of objects"
    names = f"with {abbreviate(sorted(head.keys))}" if head.keys else "without names"
    fix = (
        "give what OpenPose (version, people), AlphaPose, MMPose (instances) or MediaPipe write, "
        "COCO annotations (images, annotations, categories) or COCO results (image_id, keypoints)"
    )
    raise input_error(head.path, f"is JSON of no known kind, {place} {names}", fix)


WIDE_MARKS = (b"\xff\xfe", b"\xfe\xff")
CONTROL = frozenset(range(32)) - {*b"\t\n\v\f\r\x1a\x1b"}
"""Bytes that no text has."""


def _is_text(data: bytes) -> bool:
    """Whether bytes are the beginning of a text in UTF-8, UTF-16 with a mark, or Latin-1."""
    return data.startswith(WIDE_MARKS) or not CONTROL & {*data}
