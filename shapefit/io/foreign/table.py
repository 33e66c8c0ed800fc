"""Formats of other tools, and of no tool, that are read: how each is recognised, what reads it.

Several of trackers are HDF5 files of the same suffix, so that their recognisers share one look into
the file. Detectors of people write JSON, CSV and text, without identities over frames as a rule.
"""

from __future__ import annotations

from typing import Any

from shapefit.io.foreign.file_format import FileFormat

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


_TRACKER, _MOTION = "trackers.recognition", "motion.recognition"
_OF_A_FOLDER: Any = {"together": True, "folders": True}

FORMATS: dict[str, FileFormat] = {
    "deeplabcut-csv": _format(
        *("a DeepLabCut or Lightning Pose CSV", (".csv",), EITHER),
        *(f"{_TRACKER}:is_deeplabcut_csv", "trackers.deeplabcut_csv:record"),
    ),
    "deeplabcut-h5": _format(
        *("a DeepLabCut HDF5 file", (".h5", ".hdf5"), EITHER),
        *(f"{_TRACKER}:is_deeplabcut_hdf5", "trackers.deeplabcut_hdf5:record"),
    ),
    "jabs-h5": _format(
        *("a JABS pose file", (".h5",), IMAGES),
        *(f"{_TRACKER}:is_jabs", "trackers.jabs:record"),
    ),
    "movement-netcdf": _format(
        *("a movement netCDF file", (".nc", ".nc4"), EITHER),
        *(f"{_TRACKER}:is_movement", "trackers.movement:record"),
    ),
    "nwb-ndx-pose": _format(
        *("an NWB file", (".nwb",), EITHER),
        *(f"{_TRACKER}:is_nwb", "trackers.nwb:record"),
    ),
    "sleap-analysis-h5": _format(
        *("a SLEAP analysis file", (".h5", ".hdf5"), IMAGES),
        *(f"{_TRACKER}:is_sleap_analysis", "trackers.sleap_analysis:record"),
    ),
    "sleap-slp": _format(
        *("a SLEAP .slp file", (".slp",), IMAGES),
        *(f"{_TRACKER}:is_slp", "trackers.sleap_labels:record"),
    ),
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
    "acclaim": _format(
        *("an ASF/AMC motion", (".amc", ".asf"), SHAPES),
        *(f"{_MOTION}:is_acclaim", "motion.acclaim:record"),
        together=True,
    ),
    "anipose-csv": _format(
        *("an anipose 3D CSV", (".csv",), SHAPES),
        *(f"{_MOTION}:is_anipose", "motion.anipose_csv:record"),
    ),
    "bvh": _format(
        *("a BVH motion", (".bvh",), SHAPES),
        *(f"{_MOTION}:is_bvh", "motion.bvh:record"),
    ),
    "c3d": _format(
        *("a C3D file", (".c3d",), SHAPES),
        *(f"{_MOTION}:is_c3d", "motion.c3d:record"),
    ),
    "mesh": FileFormat(
        title="a mesh with landmarks",
        suffixes=(".obj", ".ply", ".glb"),
        recogniser="shapefit.io.motion.recognition:is_mesh",
        readers={"shapes": "shapefit.io.motion.meshes:read"},
        together=True,
    ),
    "trc": _format(
        *("a TRC file", (".trc",), SHAPES),
        *(f"{_MOTION}:is_trc", "motion.trc:record"),
    ),
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
