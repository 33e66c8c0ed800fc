"""Formats of detectors of people: JSON, CSV and text, without identities over frames as a rule."""

from __future__ import annotations

from shapefit.io.foreign.file_format import FileFormat

_ROOM = "shapefit.io.detectors"

FORMATS: dict[str, FileFormat] = {
    "alphapose-json": FileFormat(
        title="an AlphaPose file of all images",
        suffixes=(".json",),
        recogniser=f"{_ROOM}.alphapose:is_alphapose",
        recorder=f"{_ROOM}.alphapose:record",
        records=("landmarks",),
    ),
    "caliscope-csv": FileFormat(
        title="a caliscope CSV",
        suffixes=(".csv",),
        recogniser=f"{_ROOM}.caliscope:is_caliscope",
        recorder=f"{_ROOM}.caliscope:record",
        records=("landmarks",),
    ),
    "coco-annotations": FileFormat(
        title="a file of COCO annotations",
        suffixes=(".json",),
        recogniser=f"{_ROOM}.coco_annotations:is_coco_annotations",
        recorder=f"{_ROOM}.coco_annotations:record",
        records=("landmarks",),
    ),
    "coco-results": FileFormat(
        title="a file of COCO results",
        suffixes=(".json",),
        recogniser=f"{_ROOM}.coco_results:is_coco_results",
        recorder=f"{_ROOM}.coco_results:record",
        records=("landmarks",),
    ),
    "mmpose-images": FileFormat(
        title="a set of MMPose files",
        suffixes=(".json",),
        recogniser=f"{_ROOM}.mmpose:is_image",
        recorder=f"{_ROOM}.mmpose:record_images",
        records=("landmarks",),
        together=True,
        folders=True,
    ),
    "mmpose-video": FileFormat(
        title="an MMPose file",
        suffixes=(".json",),
        recogniser=f"{_ROOM}.mmpose:is_video",
        recorder=f"{_ROOM}.mmpose:record_video",
        records=("landmarks",),
    ),
    "openpose": FileFormat(
        title="a set of OpenPose files",
        suffixes=(".json",),
        recogniser=f"{_ROOM}.openpose:is_openpose",
        recorder=f"{_ROOM}.openpose:record",
        records=("landmarks",),
        together=True,
        folders=True,
    ),
    "ultralytics-txt": FileFormat(
        title="a set of YOLO pose labels",
        suffixes=(".txt",),
        recogniser=f"{_ROOM}.ultralytics:is_ultralytics",
        recorder=f"{_ROOM}.ultralytics:record",
        records=("landmarks",),
        together=True,
        folders=True,
    ),
}
