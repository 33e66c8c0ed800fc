"""COCO results: a bare list of detections without names, as MMDet and AlphaPose write it.

{image_id, category_id, keypoints [x, y, confidence, ...], score}. Confidences are taken as they
are; a landmark of 0, 0, 0 is missing, others of confidence 0 have no weight. AlphaPose, whose
image_id is the name of a file, states a scale of 0 to 6 for models of COCO, and newer models of it
give 0 to 1: where one in such a file is above 2, all are divided by 6.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from shapefit.arrays import Floats
from shapefit.errors import input_error
from shapefit.io.detectors.detections import (
    NAMED_BY_COUNT,
    Detections,
    as_recording,
    image_key,
    numbered,
)
from shapefit.io.detectors.frame_files import are_series
from shapefit.io.detectors.json_text import outline, read_json, without_collection
from shapefit.io.foreign.recording import Recording

ALPHAPOSE_LARGEST = 6.0
SURELY_NOT_OF_1 = 2.0


def is_coco_results(path: Path, head: bytes) -> bool:
    """Whether a file is a list of objects with `image_id` and `keypoints`."""
    own = outline(head)
    seen = {"image_id", "keypoints"} <= own.keys or own.points == "flat"
    return own.kind == "[" and seen


@without_collection
def record(paths: tuple[Path, ...]) -> Recording:
    """Return the detections of a file, images in the order of their first appearance."""
    path = paths[0]
    found = read_json(path)
    if not isinstance(found, list):
        raise input_error(path, "is no list of results", "give COCO results")
    detections = Detections()
    images = []
    for number, entry in enumerate(found):
        if not isinstance(entry, dict) or not isinstance(entry.get("keypoints"), list):
            raise input_error(
                f"{path}:[{number}]", "no keypoints", "give COCO results of keypoints"
            )
        images.append(image_key(entry.get("image_id"), f"{path}:[{number}]"))
        detections.numbers.append(entry["keypoints"])
        detections.identities.append(entry.get("track_id", entry.get("idx")))
    detections.frames, order = numbered(images)
    names = labels_of(order)
    detections.labels = [names[frame] for frame in detections.frames]
    values = detections.values(str(path))
    confidence, notes = scaled(values[..., 2], order)
    return as_recording(
        detections,
        values,
        np.asarray(~values.any(axis=2) | np.isnan(values).any(axis=2)),
        confidence=confidence,
        name=str(path),
        video=path.name.partition(".")[0],
        frames=len(order),
        unordered=not are_series(names),
        notes=notes,
        default_keypoints=NAMED_BY_COUNT.get(values.shape[1]),
    )


def labels_of(images: list[Any]) -> list[str]:
    """Return what images are called: their names without folder and ending, where unique."""
    texts = [str(image) for image in images]
    short = [
        Path(text).stem if isinstance(image, str) else text
        for image, text in zip(images, texts, strict=True)
    ]
    return short if len(set(short)) == len(short) else texts


def scaled(confidence: Floats, images: list[Any]) -> tuple[Floats, tuple[str, ...]]:
    """Bring AlphaPose's confidences, of COCO's models, to 0..1."""
    named = all(isinstance(image, str) for image in images)
    if not named or not confidence.size or not np.nanmax(confidence, initial=0) > SURELY_NOT_OF_1:
        return confidence, ()
    note = f"confidences divided by {ALPHAPOSE_LARGEST:g}, the largest that AlphaPose states"
    return confidence / ALPHAPOSE_LARGEST, (note,)
