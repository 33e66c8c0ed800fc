"""The table of file formats: how a file of each begins, what it holds, who reads and writes it.

A format is one row of `FORMATS`, or of `WRITTEN` where it is only written. The row is light:
functions are named as ".module:function" below `shapefit.io`, and imported when they are needed.
"""

from __future__ import annotations

import re
import struct
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from difflib import get_close_matches
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any, Generic, TypeVar

from shapefit.errors import abbreviate, input_error, listed
from shapefit.io.head import (
    Head,
    anipose_landmarks,
    decode,
    parse_header,
    unknown_json,
    unsupported_file,
)
from shapefit.io.inputs import (
    HDF5_SIGNATURE,
    is_stream,
    require_file,
    source_name,
)
from shapefit.io.layout import LANDMARKS, RESULTS, Layout
from shapefit.io.options import AS_KNOWN, InputOptions, OutputOptions, Summary
from shapefit.io.records import LandmarkSet, ResultSet
from shapefit.threads import on_threads

Record = TypeVar("Record")


@dataclass(frozen=True, kw_only=True)
class FileFormat:
    """A format of files; functions are named as `load` takes them.

    title        what a file of it is called, with its article
    suffixes     endings of its names; it is looked for in files of these names first, and an
                 output of such a name is written in it
    begins       whether a file with such a head is in this format
    recorder     of a format of others: takes the paths that are one recording, returns it
    records      the kinds (landmarks, shapes, ...) of what it can hold; its content decides
    reader       takes a path, or all that belong together, and a kind, and `gaps` (whether
                 landmarks may be unknown); returns records, for several paths notes, too
    holds        takes a path, returns the kind of what the file holds
    together     files of one folder are one recording: a frame each, or parts that need each other
    folders      a folder is an input, too
    writer       takes a path and the layout of the records, gives a RecordWriter in a `with`
    writes       the kinds that it can write
    in_metres    what it writes is in metres and upright, a sequence a file; its writer takes
                 OutputOptions, too
    angles       it is written with the joint angles of bodies, or holds nothing else
    points_only  it has no place for what is not a point: attributes, further datasets
    states_y_axis  its files say, or it is known of all of them, whether y points up or down
    """

    title: str
    suffixes: tuple[str, ...]
    begins: Callable[[Head], bool] = lambda head: False
    recorder: str | None = None
    records: tuple[str, ...] = ()
    reader: str = ""
    holds: str = ""
    together: bool = False
    folders: bool = False
    writer: str | None = None
    writes: tuple[str, ...] = ()
    in_metres: bool = False
    angles: bool = False
    points_only: bool = True
    states_y_axis: bool = True

    def has_suffix(self, path: Path) -> bool:
        """Whether the path is named like a file of this format."""
        return path.name.lower().endswith(self.suffixes)


IMAGES, SHAPES, EITHER = ("landmarks",), ("shapes",), ("landmarks", "shapes")
ANY = ("landmarks", "shapes", "result")

HDF5 = FileFormat(
    title="an HDF5 file",
    suffixes=(".h5", ".hdf5", ".hdf", ".he5"),
    begins=lambda head: head.bytes.startswith(HDF5_SIGNATURE),
    records=(*ANY, "dictionary"),
    holds=".hdf5_records:hdf5_kind",
    writer=".hdf5_writer:hdf5_output",
    writes=(*ANY, "dictionary"),
    points_only=False,
)

CSV = FileFormat(
    title="a CSV file",
    suffixes=(".csv",),
    begins=lambda head: {"item", "landmark"} <= head.columns and not HDF5.has_suffix(head.path),
    records=ANY,
    reader=".csv_file:read_csv",
    holds=".csv_file:csv_kind",
    writer=".csv_file:csv_output",
    writes=ANY,
    states_y_axis=False,
)


def _deeplabcut_csv(head: Head) -> bool:
    """Whether the first cell is `scorer`, and one of the next lines begins `bodyparts`.

    A first line can be longer than what is seen of the file; then the first cell decides.
    """
    lines = head.lines[:-1] or head.lines
    firsts = [line.split(b",", 1)[0].strip(b' "') for line in lines]
    if firsts[0] == b"scorer" and b"," in head.lines[0]:
        return len(firsts) < 3 or b"bodyparts" in firsts[1:3]
    return firsts[0] in (b"bodyparts", b"individuals") and b"coords" in firsts[1:3]


def _nwb(head: Head) -> bool:
    found = head.hdf5
    processed = any(name.startswith("processing/") for name in found.inner)
    return "nwb_version" in found.attributes or processed


def _slp(head: Head) -> bool:
    found = head.hdf5
    return "metadata@format_id" in found.inner and {"frames", "instances"} <= found.entries


def _files(ending: str, begins: Callable[[Head], bool]) -> Callable[[Head], bool]:
    """Return whether a file begins so, or one of the first in a folder."""

    def any_begins(head: Head) -> bool:
        return any(map(begins, head.files(ending) if head.is_folder else [head]))

    return any_begins


_ALPHAPOSE = re.compile(rb'\s*\{\s*"(?:[^"\\]|\\.)*"\s*:\s*\{\s*"(?:version|people|bodies)"\s*:')


def _openpose(head: Head) -> bool:
    """Whether an object has OpenPose's keys, which AlphaPose's `cmu` has, too."""
    found = head.json
    return (found.kind == "{" and bool(found.keys & {"people", "bodies"})) or found.keys == {
        "version"
    }


def _coco_results(head: Head) -> bool:
    found = head.json
    whole = {"image_id", "keypoints"} <= found.keys
    return found.kind == "[" and (whole or found.points == "flat")


def _coco_annotations(head: Head) -> bool:
    keys = head.json.keys
    known = {"images", "annotations", "categories", "licenses"}
    alone = "info" in keys and "people" not in keys
    return head.json.kind == "{" and bool(keys & known or alone)


def _mmpose_video(head: Head) -> bool:
    wanted = {"{": {"meta_info", "instance_info"}, "[": {"instances"}, "": set[str]()}
    return bool(head.json.keys & wanted[head.json.kind])


def _mmpose_images(head: Head) -> bool:
    found = head.json
    named = {"keypoints", "keypoint_scores"} <= found.keys and "instances" not in found.keys
    empty = head.bytes.strip() == b"[]"
    return found.kind == "[" and (named or found.points == "pairs" or empty)


def _yolo(head: Head) -> bool:
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


_POINT = re.compile(rb'\{\s*(?:"(?:name|id)"\s*:\s*"?\w+"?,\s*)?"x"\s*:\s*[^,{}]+,\s*"y"\s*:')


def _mediapipe(head: Head) -> bool:
    """Whether JSON begins with objects of x and y."""
    return head.json.kind != "" and _POINT.search(head.bytes) is not None


def _acclaim(head: Head) -> bool:
    lines = any(line.lstrip()[:1] in (b":", b"#") for line in head.lines)
    return head.named(".asf", ".amc") and b"\0" not in head.bytes and lines


def _caliscope(head: Head) -> bool:
    needed = {"frame_index", "point_id", "img_loc_x", "img_loc_y"}
    return needed <= head.columns and bool(head.columns & {"port", "cam_id"})


C3D_BLOCK, C3D_MAGIC = 512, 0x50
"""Bytes of the header of C3D, and its second byte."""


def _c3d(head: Head) -> bool:
    """Whether a file begins with the place of its parameters, 0x50, and numbers that agree."""
    data = head.bytes
    if len(data) < C3D_BLOCK or data[1] != C3D_MAGIC or data[0] == 0:
        return False
    points, _, first, last = struct.unpack("<HHHH", data[2:10])
    start = struct.unpack("<H", data[16:18])[0]
    agree = 0 < points < 1024 and 0 < first <= last and 1 < start < 1024 and data[0] < 8
    return head.named(".c3d") or agree


def _bvh(head: Head) -> bool:
    words = head.text.split(maxsplit=2)
    return [word.upper() for word in words[:2]] == [b"HIERARCHY", b"ROOT"]


def _table(head: Head) -> bool:
    """Whether the first line names columns of landmarks, in another layout than ours."""
    if not head.named(".csv", ".tsv", ".txt") or anipose_landmarks(head.columns):
        return False
    line = decode(head.bytes).replace("\r", "\n").partition("\n")[0]
    own = {"item", "landmark"} <= {cell.strip(' "\t') for cell in line.split(",")}
    return "\0" not in line and not own and parse_header(line) is not None


_LISTS = re.compile(rb"\s*\[\s*\[\s*(?:\[\s*)?[-\dnN]")


def _array(head: Head) -> bool:
    archive = head.bytes.startswith(b"PK\x03\x04") and head.named(".npz")
    lists = head.named(".json") and _LISTS.match(head.text) is not None
    return archive or lists or head.bytes.startswith(b"\x93NUMPY")


def _read(
    title: str,
    suffixes: str,
    records: tuple[str, ...],
    begins: Callable[[Head], bool],
    recorder: str,
    **further: Any,
) -> FileFormat:
    """Return the row of a format of others; its reader is named below `shapefit.io.readers`."""
    return FileFormat(
        title=title,
        suffixes=tuple(suffixes.split()),
        records=records,
        begins=begins,
        recorder=f".readers.{recorder}",
        **further,
    )


_SETS: Any = {"together": True, "folders": True}

FORMATS: dict[str, FileFormat] = {
    "hdf5": HDF5,
    "csv": CSV,
    "deeplabcut-csv": _read(
        *("a DeepLabCut or Lightning Pose CSV", ".csv", EITHER),
        *(_deeplabcut_csv, "deeplabcut:read_csv"),
    ),
    "deeplabcut-h5": _read(
        *("a DeepLabCut HDF5 file", ".h5 .hdf5", EITHER),
        *(lambda head: bool(head.hdf5.pandas), "deeplabcut:read_hdf5"),
    ),
    "jabs-h5": _read(
        *("a JABS pose file", ".h5", IMAGES),
        *(lambda head: "poseest/points" in head.hdf5.inner, "trackers:read_jabs"),
    ),
    "movement-netcdf": _read(
        *("a movement netCDF file", ".nc .nc4", EITHER),
        *(lambda head: "ds_type" in head.hdf5.attributes, "trackers:read_movement"),
    ),
    "nwb-ndx-pose": _read("an NWB file", ".nwb", EITHER, _nwb, "trackers:read_nwb"),
    "sleap-analysis-h5": _read(
        *("a SLEAP analysis file", ".h5 .hdf5", IMAGES),
        *(lambda head: {"tracks", "node_names"} <= head.hdf5.entries, "sleap:read_analysis"),
    ),
    "sleap-slp": _read("a SLEAP .slp file", ".slp", IMAGES, _slp, "sleap:read_labels"),
    "alphapose-json": _read(
        *("an AlphaPose file of all images", ".json", IMAGES),
        *(lambda head: _ALPHAPOSE.match(head.text) is not None, "detections:read_alphapose"),
    ),
    "caliscope-csv": _read("a caliscope CSV", ".csv", IMAGES, _caliscope, "tables:read_caliscope"),
    "coco-annotations": _read(
        *("a file of COCO annotations", ".json", IMAGES),
        *(_coco_annotations, "detections:read_coco_annotations"),
    ),
    "coco-results": _read(
        *("a file of COCO results", ".json", IMAGES),
        *(_coco_results, "detections:read_coco_results"),
    ),
    "mmpose-images": _read(
        *("a set of MMPose files", ".json", IMAGES),
        *(_files(".json", _mmpose_images), "detections:read_mmpose_images"),
        **_SETS,
    ),
    "mmpose-video": _read(
        *("an MMPose file", ".json", IMAGES), *(_mmpose_video, "detections:read_mmpose_video")
    ),
    "openpose": _read(
        *("a set of OpenPose files", ".json", IMAGES),
        *(_files(".json", _openpose), "detections:read_openpose"),
        **_SETS,
    ),
    "ultralytics-txt": _read(
        *("a set of YOLO pose labels", ".txt", IMAGES),
        *(_files(".txt", _yolo), "yolo:read_yolo"),
        **_SETS,
    ),
    "acclaim": _read(
        *("an ASF/AMC motion", ".amc .asf", SHAPES),
        *(_acclaim, "motion:read_acclaim"),
        together=True,
    ),
    "anipose-csv": _read(
        *("an anipose 3D CSV", ".csv", SHAPES),
        *(lambda head: bool(anipose_landmarks(head.columns)), "markers:read_anipose"),
    ),
    "bvh": _read("a BVH motion", ".bvh", SHAPES, _bvh, "motion:read_bvh"),
    "c3d": _read("a C3D file", ".c3d", SHAPES, _c3d, "motion:read_c3d"),
    "trc": _read(
        *("a TRC file", ".trc", SHAPES),
        *(lambda head: head.text.lstrip()[:12].lower() == b"pathfiletype", "markers:read_trc"),
    ),
    "table": _read(
        "a table of landmarks", ".csv .tsv .txt", EITHER, _table, "tables:read_any_table",
        states_y_axis=False,
    ),
    "arrays": _read(
        "an array of landmarks", ".npy .npz", IMAGES, _array, "arrays:read_array",
        states_y_axis=False,
    ),
    "mediapipe": _read(
        "a file of MediaPipe's landmarks", ".json", IMAGES, _mediapipe, "detections:read_mediapipe"
    ),
}  # fmt: skip
"""Those of the package come first; the others are asked before them, in this order."""


def detect_format(path: Path, name: str = "auto") -> FileFormat:
    """Return the format of a file or folder, by what it begins with; text of no known kind is CSV.

    Standard input and pipes are CSV. With another `name` than auto it is that format. Raises
    InputError as `require_file` does, for unknown names, and for files that are something else.
    """
    if is_stream(path):
        return CSV
    if name != "auto":
        return named_format(name, FORMATS)
    if path.is_dir():
        return _detect_folder(Head(path))
    require_file(path)
    if not path.is_file():
        return CSV
    head = Head(path)
    for known in _likely_first(path):
        if known.begins(head):
            return known
    if HDF5.has_suffix(path):
        fix = "give an HDF5 file, or name it .csv if it is CSV"
        raise input_error(path, "is not an HDF5 file", fix)
    if (error := unsupported_file(head)) is not None:
        raise error
    if b"\0" in head.bytes and not CSV.has_suffix(path):
        titles = listed(known.title for known in FORMATS.values())
        raise input_error(path, "is of no known format", f"give {titles}")
    if head.json.kind:
        raise unknown_json(head)
    return CSV


def named_format(name: str, known: Mapping[str, FileFormat], key: str = "format") -> FileFormat:
    """Return the format of a name. Raises InputError at the key for unknown ones."""
    if name not in known:
        near = get_close_matches(name, known, n=1, cutoff=0.4)
        fix = f"did you mean {near[0]}?" if near else f"use auto, {listed(known)}"
        raise input_error(key, f"there is no format {name!r}", fix)
    return known[name]


def _detect_folder(head: Head) -> FileFormat:
    """Return the format of a folder whose files are one recording."""
    folders = [known for known in FORMATS.values() if known.folders]
    for known in folders:
        if known.begins(head):
            return known
    path = head.path
    looked = f", and holds none of these: {listed(known.title for known in folders)}"
    inner = sorted(str(each) for each in path.iterdir() if each.is_dir())
    fix = f"name the files in it, e.g. '{path}/*.h5'"
    fix = f"name the folders in it: {abbreviate(inner, 3)}" if inner else fix
    raise input_error(path, f"it is a folder{looked}", fix)


def _likely_first(path: Path) -> Iterator[FileFormat]:
    """Yield the formats whose names fit before the others, and each time the package's own last.

    Many formats are HDF5 or CSV inside, so they are asked before ours.
    """
    others = [known for known in FORMATS.values() if known not in (HDF5, CSV)]
    ordered = [*others, HDF5, CSV]
    yield from (known for known in ordered if known.has_suffix(path))
    yield from (known for known in ordered if not known.has_suffix(path))


def group_inputs(
    paths: Sequence[Path], options: InputOptions
) -> list[tuple[FileFormat, tuple[Path, ...]]]:
    """Return the inputs in order, each with its format; files that are one recording together."""
    groups: dict[tuple[str, str], tuple[FileFormat, list[Path]]] = {}
    formats = on_threads(partial(detect_format, name=options.format), paths)
    for path, known in zip(paths, formats, strict=True):
        shared = known.together and not path.is_dir()
        key = (known.title, str(path.parent)) if shared else ("", str(path))
        groups.setdefault(key, (known, []))[1].append(path)
    return [(known, tuple(own)) for known, own in groups.values()]


def mixture(groups: Sequence[tuple[FileFormat, tuple[Path, ...]]]) -> tuple[str, ...]:
    """Warn of inputs in several formats, some of them of other tools, whose names may not agree."""
    counts = Counter(known.title for known, _ in groups)
    if len(counts) < 2 or all(known.recorder is None for known, _ in groups):
        return ()
    found = listed((f"{title} ({number})" for title, number in counts.items()), "and")
    return (f"several formats in one call: {found}; landmarks are matched by their names",)


def check_holds(path: Path, kind: str, known: FileFormat) -> None:
    """Raise InputError where a file of this format cannot hold records of a kind."""
    if kind not in known.records or known.recorder is not None:
        able = [each for each in FORMATS.values() if kind in each.records and not each.recorder]
        found = f"is {known.title}, not {listed(each.title for each in able)}"
        found = found if path.is_file() else "is not a file on a disk"
        raise input_error(source_name(path), found, f"give a shapefit-{kind} file")


def load(place: str) -> Callable[..., Any]:
    """Import a function by its place, "module:function"; ".module" is one below `shapefit.io`."""
    module, _, name = place.partition(":")
    function: Callable[..., Any] = getattr(import_module(module, "shapefit.io"), name)
    return function


# Writing.


class RecordWriter(Generic[Record]):
    """Takes records one after another; `attributes` are stored with the file on a clean exit.

    After that `summary` says what was written. `begun` is whether a record was appended.
    """

    def __init__(self) -> None:
        self.attributes: dict[str, str | float | int] = {}
        self.summary = Summary()
        self.begun = False

    def append(self, record: Record) -> None:
        """Write the items of a record after those that are there."""
        raise NotImplementedError

    def check_begun(self) -> None:
        """Raise ValueError where nothing was appended."""
        if not self.begun:
            raise ValueError("nothing was appended; append one record, which may be empty")


def _metres(title: str, writer: str, *suffixes: str, angles: bool = False) -> FileFormat:
    """Return the row of files in metres; the writer is named below `shapefit.io.writers`."""
    return FileFormat(
        title=title,
        suffixes=suffixes,
        writer=f".writers.{writer}",
        writes=("shapes", "result"),
        in_metres=True,
        angles=angles,
    )


WRITTEN: dict[str, FileFormat] = {
    "bvh": _metres("a BVH file", "bones:bvh_output", ".bvh"),
    "c3d": _metres("a C3D file", "markers:c3d_output", ".c3d"),
    "trc": _metres("a TRC file", "markers:trc_output", ".trc", angles=True),
    "mot": _metres("a MOT file", "tables:mot_output", ".mot", angles=True),
    "metres": _metres("a table in metres", "tables:metres_output", ".metres.csv"),
    "angles": _metres(
        "a table of joint angles", "tables:angles_output", ".angles.csv", angles=True
    ),
}
"""Formats that are written for other tools; those of them that can be read have a row above."""


def targets() -> dict[str, FileFormat]:
    """Return the formats that can be written, by their names."""
    return {name: known for name, known in FORMATS.items() if known.writer} | WRITTEN


def landmark_writer(target: Path) -> AbstractContextManager[RecordWriter[LandmarkSet]]:
    """Give a writer of landmarks for use in a `with`; `append` takes chunk after chunk.

    A name that ends in .csv and `-` (standard output) give CSV,
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
    known = check_target_format(target, form.kind, to)
    if is_stream(target) and known is not CSV:
        found = "files of this format cannot go to standard output"
        raise input_error("output", found, "name a file")
    if options.given and not known.in_metres:
        found = f"{known.title} keeps the unit and the axes of what is written"
        raise input_error(
            options.given[0], found, "leave it out, or end the name in .metres.csv, .trc or .c3d"
        )
    further = (options,) if known.in_metres else ()
    writer: AbstractContextManager[RecordWriter[Any]]
    writer = load(str(known.writer))(target, form, *further)
    return writer


def find_target_format(path: Path, name: str = "auto") -> FileFormat:
    """Return the format that an output path asks for: CSV for `-`, HDF5 for a name without ending.

    With another `name` than auto it is that format. Raises InputError for an ending of no format.
    """
    if name != "auto":
        return named_format(name, targets(), "to")
    if is_stream(path):
        return CSV
    endings = {suffix: known for known in targets().values() for suffix in known.suffixes}
    if named := [suffix for suffix in endings if path.name.lower().endswith(suffix)]:
        return endings[max(named, key=len)]
    if path.suffix:
        found = f"no format that is written ends in {path.suffix}"
        raise input_error(path, found, f"end the name in {listed(endings)}")
    return HDF5


def check_target_format(path: Path, kind: str, name: str = "auto") -> FileFormat:
    """Return the format of an output. Raises InputError where it cannot hold records of a kind."""
    known = find_target_format(path, name)
    if kind in known.writes:
        return known
    name = known.title.split()[1]
    if kind == "landmarks" and known.in_metres:
        fix = "lift them with `shapefit fit` first, or write .h5 or .csv"
        raise input_error(path, f"2D landmarks cannot be {name}", fix)
    raise input_error(path, f"a {kind} cannot be {name}", "give it a name in .h5")
