"""MMPose's predictions: a list of frames, or of the people of one image, with or without names.

A video is a list of {frame_id, instances}, an image a list of instances; both may stand as
`instance_info` beside `meta_info`, which has the names. An instance has keypoints [[x, y], ...]
and keypoint_scores, which are taken as they are; they may be a little above 1.
"""

from __future__ import annotations

from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from shapefit.errors import input_error
from shapefit.io.detectors.detections import Detections, as_recording, edges_of, images_in
from shapefit.io.detectors.json_text import (
    Outline,
    first_outline,
    outline,
    read_json,
    without_collection,
)
from shapefit.io.foreign.recording import Recording

FIX = "give the predictions of MMPose's inferencer"


def is_video(path: Path, head: bytes) -> bool:
    """Whether a file is a list of frames with instances, or has `instance_info`."""
    own = outline(head)
    if own.kind == "[":
        return "instances" in own.keys
    return own.kind == "{" and bool(own.keys & {"meta_info", "instance_info"})


def is_image(path: Path, head: bytes) -> bool:
    """Whether a file, or the first files of a folder, are a list of instances of one image."""
    if head:
        nobody = head.strip() == b"[]"
        return nobody or _is_list_of_instances(outline(head))
    return any(_is_list_of_instances(own) for own in first_outline(path))


@without_collection
def record_video(paths: tuple[Path, ...]) -> Recording:
    """Return the frames of one file."""
    path = paths[0]
    found = read_json(path)
    meta: Any = {}
    if isinstance(found, dict):
        meta, found = found.get("meta_info"), found.get("instance_info")
    if not isinstance(found, list):
        raise input_error(path, "no list of instances", FIX)
    if found and isinstance(found[0], dict) and "instances" not in found[0]:
        found = [{"frame_id": 0, "instances": found}]
    detections = Detections.in_file(path, step=2)
    for place, frame in enumerate(found):
        instances = frame.get("instances") if isinstance(frame, dict) else None
        if not isinstance(instances, list):
            raise input_error(f"{path}:[{place}]", "a frame without `instances`", FIX)
        label = frame.get("frame_id")
        _add(detections, instances, place, str(place if label is None else label), path)
    return _recorded(detections, len(found), meta)


def record_images(paths: tuple[Path, ...]) -> Recording:
    """Return the images of a folder, or these files, as one recording."""
    images = images_in(paths, ".json")
    detections = Detections.in_images(images, step=2)
    for path, part, frame, label in images.files:
        instances = read_json(path)
        if not isinstance(instances, list):
            raise input_error(path, "no list of instances, as the other files", FIX)
        _add(detections, instances, frame, label, path, part)
    return _recorded(detections, len(images.files), {})


def _is_list_of_instances(own: Outline) -> bool:
    seen = {"keypoints", "keypoint_scores"} <= own.keys and "instances" not in own.keys
    return own.kind == "[" and (seen or own.points == "pairs")


def _add(
    detections: Detections,
    instances: list[Any],
    frame: int,
    label: str,
    path: Path,
    video: str | None = None,
) -> None:
    """Add the people of a frame, as x, y and score of each landmark."""
    for number, instance in enumerate(instances):
        place = f"{path}: frame {label}, instance {number}"
        points = instance.get("keypoints") if isinstance(instance, dict) else None
        if not isinstance(points, list):
            raise input_error(place, "no keypoints", FIX)
        scores = instance.get("keypoint_scores")
        if scores is None:
            scores = [1.0] * len(points)
        try:
            widths = set(map(len, points))
        except TypeError:
            widths = {0}
        if not widths <= {2} or not isinstance(scores, list) or len(scores) != len(points):
            found = f"{len(points)} keypoints that are not x and y with a score each"
            found = "3D keypoints" if widths == {3} else found
            raise input_error(place, found, "give predictions of 2D landmarks")
        detections.scores.append(scores)
        detections.add(
            [*chain.from_iterable(points)], frame, label, instance.get("track_id"), video
        )


def _recorded(detections: Detections, frames: int, meta: Any) -> Recording:
    values, scores = detections.values(), detections.confidence()
    names = _names(meta, values.shape[1])
    return as_recording(
        detections,
        values,
        np.isnan(values).any(axis=2) | ~(scores > 0),
        confidence=scores,
        frames=frames,
        landmark_names=names,
        edges=edges_of(meta.get("skeleton_links"), values.shape[1]) if names else (),
    )


def _names(meta: Any, count: int) -> tuple[str, ...] | None:
    """Return the names in `meta_info`: landmark numbers -> names, as texts or as a list."""
    known = meta.get("keypoint_id2name") if isinstance(meta, dict) else None
    if isinstance(known, dict):
        known = [known.get(str(number)) for number in range(count)]
    if not isinstance(known, list) or len(known) != count or len({*map(str, known)}) != count:
        return None
    return tuple(known) if all(isinstance(name, str) for name in known) else None
