"""Formats of other tools, and of no tool, that are read: how each is recognised, what reads it.

Several of trackers are HDF5 files of the same suffix, so that their recognisers share one look into
the file. Detectors of people write JSON, CSV and text, without identities over frames as a rule.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any


@dataclass(frozen=True, kw_only=True)
class FileFormat:
    """A format of files. Functions are named as "module:function".

    title        what a file of it is called, with its article
    suffixes     endings of its names; it is looked for in files of these names first, and an
                 output of such a name is written in it
    recogniser   takes a path and the first HEAD_BYTES of the file; whether it is in this format;
                 "" where files are written only
    recorder     of a format of others: takes the paths that are one recording, returns it
    records      the kinds that a recording can be of; its content decides
    together     files of one folder are one recording: a frame each, or parts that need each other;
                 its readers take all their paths and return a record and notes
    folders      a folder is an input, too; the recogniser is given it with no bytes
    readers      by kind (landmarks, shapes, result, dictionary): takes a path, returns the record,
                 or a SourceFile that gives out parts of it. A reader of shapes takes `gaps`, too:
                 whether landmarks may be unknown
    reader       of a format of ours that holds every dataset: takes a path and a layout, opens a
                 StoredReader
    form         of such a format: takes a path, returns the layout that the file says it has
    writer       takes a path and the layout of the records, gives a RecordWriter in a `with`
    writes       the kinds that it can write
    in_metres    what it writes is in metres and upright; its writer takes OutputOptions, too
    atom_meshes  that writer has a place for the meshes that results mix
    by_sequence  its files hold one sequence each, or nothing but sequences
    points_only  it has no place for what is not a point: attributes, further datasets
    states_y_axis  its files say, or it is known of all of them, whether y points up or down
    """

    title: str
    suffixes: tuple[str, ...]
    recogniser: str = ""
    recorder: str | None = None
    records: tuple[str, ...] = ()
    together: bool = False
    folders: bool = False
    readers: Mapping[str, str] = field(default_factory=dict)
    reader: str | None = None
    form: str | None = None
    writer: str | None = None
    writes: tuple[str, ...] = ()
    in_metres: bool = False
    atom_meshes: bool = False
    by_sequence: bool = False
    points_only: bool = True
    states_y_axis: bool = True

    def has_suffix(self, path: Path) -> bool:
        """Whether the path is named like a file of this format."""
        return path.name.lower().endswith(self.suffixes)


IMAGES, SHAPES = ("landmarks",), ("shapes",)
EITHER = ("landmarks", "shapes")


def _format(
    title: str,
    suffixes: tuple[str, ...],
    records: tuple[str, ...],
    recogniser: str,
    recorder: str,
    **further: Any,
) -> FileFormat:
    """Return an entry; functions are named as "folder.module:function" below `shapefit.io`."""
    return FileFormat(
        title=title,
        suffixes=suffixes,
        records=records,
        recogniser=f"shapefit.io.{recogniser}",
        recorder=f"shapefit.io.{recorder}",
        **further,
    )


def _of(
    place: str, title: str, suffixes: tuple[str, ...], records: tuple[str, ...], **further: Any
) -> FileFormat:
    """Return an entry of "folder.module", which `recognition` knows by the name of the module."""
    recogniser = f"foreign.recognition:is_{place.partition('.')[2]}"
    return _format(title, suffixes, records, recogniser, f"{place}:record", **further)


_OF_A_FOLDER: Any = {"together": True, "folders": True}

FORMATS: dict[str, FileFormat] = {
    "deeplabcut-csv": _of(
        "trackers.deeplabcut_csv", "a DeepLabCut or Lightning Pose CSV", (".csv",), EITHER
    ),
    "deeplabcut-h5": _of(
        "trackers.deeplabcut_hdf5", "a DeepLabCut HDF5 file", (".h5", ".hdf5"), EITHER
    ),
    "jabs-h5": _of("trackers.jabs", "a JABS pose file", (".h5",), IMAGES),
    "movement-netcdf": _of("trackers.movement", "a movement netCDF file", (".nc", ".nc4"), EITHER),
    "nwb-ndx-pose": _of("trackers.nwb", "an NWB file", (".nwb",), EITHER),
    "sleap-analysis-h5": _of(
        "trackers.sleap_analysis", "a SLEAP analysis file", (".h5", ".hdf5"), IMAGES
    ),
    "sleap-slp": _of("trackers.sleap_labels", "a SLEAP .slp file", (".slp",), IMAGES),
    "alphapose-json": _format(
        *("an AlphaPose file of all images", (".json",), IMAGES),
        *("detectors.openpose:is_alphapose", "detectors.openpose:record_all"),
    ),
    "caliscope-csv": _format(
        *("a caliscope CSV", (".csv",), IMAGES),
        *("detectors.caliscope:is_caliscope", "detectors.caliscope:record"),
    ),
    "coco-annotations": _format(
        *("a file of COCO annotations", (".json",), IMAGES),
        *("detectors.coco:is_coco_annotations", "detectors.coco:record_annotations"),
    ),
    "coco-results": _format(
        *("a file of COCO results", (".json",), IMAGES),
        *("detectors.coco:is_coco_results", "detectors.coco:record_results"),
    ),
    "mmpose-images": _format(
        *("a set of MMPose files", (".json",), IMAGES),
        *("detectors.mmpose:is_image", "detectors.mmpose:record_images"),
        **_OF_A_FOLDER,
    ),
    "mmpose-video": _format(
        *("an MMPose file", (".json",), IMAGES),
        *("detectors.mmpose:is_video", "detectors.mmpose:record_video"),
    ),
    "openpose": _format(
        *("a set of OpenPose files", (".json",), IMAGES),
        *("detectors.openpose:is_openpose", "detectors.openpose:record"),
        **_OF_A_FOLDER,
    ),
    "ultralytics-txt": _format(
        *("a set of YOLO pose labels", (".txt",), IMAGES),
        *("detectors.ultralytics:is_ultralytics", "detectors.ultralytics:record"),
        **_OF_A_FOLDER,
    ),
    "acclaim": _of("motion.acclaim", "an ASF/AMC motion", (".amc", ".asf"), SHAPES, together=True),
    "anipose-csv": _of("motion.anipose_csv", "an anipose 3D CSV", (".csv",), SHAPES),
    "bvh": _of("motion.bvh", "a BVH motion", (".bvh",), SHAPES),
    "c3d": _of("motion.c3d", "a C3D file", (".c3d",), SHAPES),
    "mesh": FileFormat(
        title="a mesh with landmarks",
        suffixes=(".obj", ".ply", ".glb"),
        recogniser="shapefit.io.foreign.recognition:is_mesh",
        readers={"shapes": "shapefit.io.motion.meshes:read"},
        together=True,
    ),
    "trc": _of("motion.trc", "a TRC file", (".trc",), SHAPES),
    "table": _format(
        *("a table of landmarks", (".csv", ".tsv", ".txt"), EITHER),
        *("plain.any_table:is_table", "plain.any_table:record"),
        states_y_axis=False,
    ),
    "arrays": _format(
        *("an array of landmarks", (".npy", ".npz"), IMAGES),
        *("plain.arrays:is_array", "plain.arrays:record"),
        states_y_axis=False,
    ),
    "mediapipe": _format(
        *("a file of MediaPipe's landmarks", (".json",), IMAGES),
        *("plain.mediapipe:is_mediapipe", "plain.mediapipe:record"),
    ),
}
