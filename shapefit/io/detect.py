"""The table of formats that are read, and which of them a file is in, by its
content.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from functools import lru_cache
from itertools import islice
from pathlib import Path

from shapefit.errors import InputError, input_error, listed
from shapefit.io.formats import (
    CSV,
    FIRST,
    HDF5,
    OURS,
    FileFormat,
    Head,
    find_format,
    our_format,
)
from shapefit.io.inputs import HDF5_SIGNATURE, is_stream, require_file
from shapefit.io.options import InputOptions
from shapefit.io.readers import (
    arrays,
    c3d,
    coco,
    deeplabcut,
    detections,
    landmark_lists,
    markers,
    morphometrics,
    motion,
    tables,
    trackers,
)
from shapefit.io.readers.text import read_json
from shapefit.io.unread import describe_json, unread_error

CONTROL = frozenset(range(32)) - {*b"\t\n\v\f\r\x1a\x1b"}
"""Bytes that no text has."""

CALIBRATION = re.compile(rb"\b(?:camera_|intrinsic_)?matrix\"?\s*[=:]", re.IGNORECASE)
"""What a calibration has near its beginning, in TOML, YAML or JSON."""


def detect_format(path: Path, name: str = "auto") -> FileFormat:
    """Return the format of a file or folder, by its content or by the format's `name`.

    With `auto` it is recognised: text of no known kind is CSV, and so are standard
    input and pipes. Raises InputError as `require_file` does, for unknown names, and
    for files that are something else.
    """
    if name != "auto" and not is_stream(path):
        chosen = find_format(name, FORMATS)
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
    if (whole := _format_of_empty_label(path)) is not None:
        return whole
    require_file(path)
    if not path.is_file():
        return CSV
    head = Head(path)
    for one in FORMATS.values():
        if one.recognise(head):
            return one
    unread = unread_error(path, head)
    if unread is not None:
        raise unread
    if head.bytes.startswith(HDF5_SIGNATURE):
        return HDF5
    if head.has_suffix(*HDF5.suffixes):
        fix = "give an HDF5 file, or name it .csv if it is CSV"
        raise input_error(path, "is not an HDF5 file", fix)
    if CALIBRATION.search(head.text):
        fault = "is a calibration of cameras, not landmarks"
        raise input_error(path, fault, "give it as --calibration")
    if head.has_suffix(".yaml", ".yml"):
        fix = "give the landmarks; a config is given as -c"
        raise input_error(path, "is a YAML file, not landmarks", fix)
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
        raise _unknown_json_error(path, head)
    return CSV


def _detect_folder(path: Path) -> FileFormat:
    """Return the format of a folder whose files are one recording.

    Raises InputError where they are in none of the formats that have such folders.
    """
    files = [file for file in sorted(path.iterdir()) if file.is_file()]
    folders = [one for one in FORMATS.values() if one.together]
    for one in folders:
        # Files of images without people can be empty, and many before the first.
        filled = (
            file
            for file in files
            if file.name.lower().endswith(one.suffixes) and file.stat().st_size
        )
        if any(one.recognise(Head(file)) for file in islice(filled, FIRST)):
            return one
    kinds = listed(one.title for one in folders)
    fix = "name the files in it, or a folder of such files"
    raise input_error(path, f"it is a folder, and holds none of these: {kinds}", fix)


def _format_of_empty_label(path: Path) -> FileFormat | None:
    """Return YOLO for an empty .txt beside labels of YOLO, else None.

    It is the label of an image without anybody.
    """
    yolo = FORMATS["ultralytics-txt"]
    named = path.name.lower().endswith(yolo.suffixes)
    if not named or not path.is_file() or path.stat().st_size:
        return None
    folder = path.parent
    return yolo if _has_yolo_labels(folder, folder.stat().st_mtime_ns) else None


@lru_cache(maxsize=16)
def _has_yolo_labels(folder: Path, _mtime_ns: int) -> bool:
    """Whether a folder has label files of YOLO; cached until the folder changes."""
    try:
        return _detect_folder(folder) is FORMATS["ultralytics-txt"]
    except InputError:
        return False


def group_inputs(
    paths: Sequence[Path], options: InputOptions
) -> list[tuple[FileFormat, tuple[Path, ...]]]:
    """Group input paths, one recording a group; return each group after its format."""
    groups: dict[tuple[str, Path], tuple[FileFormat, list[Path]]] = {}
    for path in paths:
        one = detect_format(path, options.format)
        shared = one.together and not path.is_dir()
        key = (one.title, path.parent) if shared else ("", path)
        groups.setdefault(key, (one, []))[1].append(path)
    return [(one, tuple(files)) for one, files in groups.values()]


OF_LANDMARKS = ("landmarks",)
"""What a format holds that is of images alone."""

OF_SHAPES = ("shapes",)
"""What a format holds that is of 3D alone."""

OF_EITHER = ("landmarks", "shapes")
"""What a format holds of which a file decides."""

ENDINGS_OF_HDF5 = (".h5", ".hdf5")
"""Of files of HDF5, whoever writes them."""

ENDINGS_OF_JSON = (".json",)
"""Of JSON of detectors and trackers."""

ENDINGS_OF_TABLES = (".csv",)
"""Of tables that are told apart by their headers."""

FORMATS: dict[str, FileFormat] = {
    **OURS,
    "deeplabcut-csv": FileFormat(
        "a DeepLabCut or Lightning Pose CSV",
        ENDINGS_OF_TABLES,
        OF_EITHER,
        deeplabcut.is_csv,
        deeplabcut.read_deeplabcut_csv,
    ),
    "deeplabcut-h5": FileFormat(
        "a DeepLabCut HDF5 file",
        ENDINGS_OF_HDF5,
        OF_EITHER,
        deeplabcut.is_hdf5,
        deeplabcut.read_hdf5,
    ),
    "jabs-h5": FileFormat(
        "a JABS pose file",
        ENDINGS_OF_HDF5,
        OF_LANDMARKS,
        trackers.is_jabs,
        trackers.read_jabs,
    ),
    "movement-netcdf": FileFormat(
        "a movement netCDF file",
        (".nc", ".nc4"),
        OF_EITHER,
        trackers.is_movement,
        trackers.read_movement,
    ),
    "nwb-ndx-pose": FileFormat(
        "an NWB file",
        (".nwb",),
        OF_EITHER,
        trackers.is_nwb,
        trackers.read_nwb,
    ),
    "sleap-analysis-h5": FileFormat(
        "a SLEAP analysis file",
        ENDINGS_OF_HDF5,
        OF_LANDMARKS,
        trackers.is_sleap_analysis,
        trackers.read_sleap_analysis,
    ),
    "sleap-slp": FileFormat(
        "a SLEAP .slp file",
        (".slp",),
        OF_LANDMARKS,
        trackers.is_slp,
        trackers.read_slp,
    ),
    "caliscope-csv": FileFormat(
        "a caliscope CSV",
        ENDINGS_OF_TABLES,
        OF_LANDMARKS,
        tables.is_caliscope,
        tables.read_caliscope,
    ),
    "coco-annotations": FileFormat(
        "a file of COCO annotations",
        ENDINGS_OF_JSON,
        OF_LANDMARKS,
        coco.is_coco_annotations,
        coco.read_coco_annotations,
        json_keys=("images", "annotations", "categories"),
    ),
    "coco-results": FileFormat(
        "a file of COCO results",
        ENDINGS_OF_JSON,
        OF_LANDMARKS,
        coco.is_coco_results,
        coco.read_coco_results,
        json_keys=("image_id", "keypoints"),
    ),
    "mmpose-video": FileFormat(
        "an MMPose file",
        ENDINGS_OF_JSON,
        OF_LANDMARKS,
        detections.is_mmpose_video,
        detections.read_mmpose_video,
        json_keys=("meta_info", "instance_info", "instances"),
    ),
    "mmpose-images": FileFormat(
        "a set of MMPose, Hugging Face or Ultralytics files",
        ENDINGS_OF_JSON,
        OF_LANDMARKS,
        detections.is_people_of_an_image,
        detections.read_image_files,
        together=True,
        json_keys=("keypoints", "keypoint_scores"),
    ),
    "openpose": FileFormat(
        "a set of OpenPose files",
        ENDINGS_OF_JSON,
        OF_LANDMARKS,
        detections.is_openpose,
        detections.read_image_files,
        together=True,
        json_keys=("people", "pose_keypoints_2d"),
    ),
    "ultralytics-txt": FileFormat(
        "a set of YOLO pose labels",
        (".txt",),
        OF_LANDMARKS,
        detections.is_yolo,
        detections.read_yolo,
        together=True,
    ),
    "tps": FileFormat(
        "a TPS file",
        (".tps",),
        OF_EITHER,
        morphometrics.is_tps,
        morphometrics.read_tps,
    ),
    "pts": FileFormat(
        "a set of .pts files",
        (".pts",),
        OF_LANDMARKS,
        morphometrics.is_pts,
        morphometrics.read_pts,
        together=True,
    ),
    "acclaim": FileFormat(
        "an ASF/AMC motion",
        (".amc", ".asf"),
        OF_SHAPES,
        motion.is_acclaim,
        motion.read_acclaim,
    ),
    "anipose-csv": FileFormat(
        "an anipose 3D CSV",
        ENDINGS_OF_TABLES,
        OF_SHAPES,
        tables.is_anipose,
        tables.read_any_table,
    ),
    "bvh": FileFormat(
        "a BVH motion",
        (".bvh",),
        OF_SHAPES,
        motion.is_bvh,
        motion.read_bvh,
    ),
    "c3d": FileFormat(
        "a C3D file",
        (".c3d",),
        OF_EITHER,
        c3d.is_c3d,
        c3d.read_c3d,
    ),
    "trc": FileFormat(
        "a TRC file",
        (".trc",),
        OF_EITHER,
        markers.is_trc,
        markers.read_trc,
    ),
    "vicon-csv": FileFormat(
        "a Vicon Nexus CSV of trajectories",
        ENDINGS_OF_TABLES,
        OF_EITHER,
        markers.is_vicon,
        markers.read_vicon,
    ),
    "table": FileFormat(
        "a table of landmarks",
        (".csv", ".tsv", ".txt"),
        OF_EITHER,
        tables.is_table,
        tables.read_any_table,
        states_y_axis=False,
        either=True,
    ),
    "mediapipe": FileFormat(
        "a file of MediaPipe's landmarks",
        ENDINGS_OF_JSON,
        OF_LANDMARKS,
        landmark_lists.is_landmark_lists,
        landmark_lists.read_landmark_lists,
        json_keys=("pose_landmarks", "landmarks", "x", "y", "visibility"),
    ),
    "arrays": FileFormat(
        "an array of landmarks",
        (".npy", ".npz"),
        OF_EITHER,
        arrays.is_array,
        arrays.read_array,
        states_y_axis=False,
        either=True,
    ),
    "arrays-3d": FileFormat(
        "an array of 3D points",
        (".npy", ".npz"),
        OF_SHAPES,
        lambda head: False,
        arrays.read_shape_array,
    ),
}
"""Those of the package come first; the others are asked in this order."""


def _unknown_json_error(path: Path, head: Head) -> InputError:
    """Return the InputError for JSON of no known format: its keys, similar formats."""
    near = [
        f"{one.title} has {listed(one.json_keys, 'and')}"
        for one in FORMATS.values()
        if head.inner_keys & {*one.json_keys}
    ]
    kinds = f" ({', '.join(near)})" if near else ""
    return input_error(path, describe_json(head) + kinds, GIVE_JSON)


GIVE_JSON = (
    "give JSON of OpenPose, AlphaPose, MMPose, MediaPipe or COCO (docs/formats.md)"
)
