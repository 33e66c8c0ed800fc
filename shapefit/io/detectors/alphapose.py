"""AlphaPose's one file of all images, in the layouts `open` and `cmu`.

{image: {version, people: [{pose_keypoints_2d}]}} or {image: {version, bodies: [{joints}]}}. The
folder `sep-json` that it writes beside this file has a file for each image, as OpenPose has.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from shapefit.errors import input_error
from shapefit.io.detectors.coco_results import labels_of, scaled
from shapefit.io.detectors.detections import NAMED_BY_COUNT, Detections, as_recording
from shapefit.io.detectors.json_text import BYTE_ORDER_MARK, read_json, without_collection
from shapefit.io.detectors.openpose import keypoints_of, people_of
from shapefit.io.foreign.recording import Recording

_BEGINNING = re.compile(rb'\s*\{\s*"(?:[^"\\]|\\.)*"\s*:\s*\{\s*"(?:version|people|bodies)"\s*:')


def is_alphapose(path: Path, head: bytes) -> bool:
    """Whether a file is an object of images, of which the first has people."""
    return _BEGINNING.match(head.removeprefix(BYTE_ORDER_MARK)) is not None


@without_collection
def record(paths: tuple[Path, ...]) -> Recording:
    """Return the people of all images, in the order of the file."""
    path = paths[0]
    found = read_json(path)
    if not isinstance(found, dict):
        raise input_error(path, "is no object of images", "give AlphaPose's results")
    detections = Detections()
    images = list(found)
    labels = labels_of(images)
    for place, (image, contents) in enumerate(found.items()):
        people = people_of(contents)
        if people is None:
            raise input_error(f"{path}: {image}", "no list of people", "give AlphaPose's results")
        for person in people:
            if not isinstance(person, dict):
                fix = "check what wrote the file"
                raise input_error(f"{path}: {image}", "a person that is no object", fix)
            detections.numbers.append(keypoints_of(person, path))
            detections.frames.append(place)
            detections.labels.append(labels[place])
            detections.identities.append(person.get("idx"))
    values = detections.values(str(path))
    confidence, notes = scaled(values[..., 2], images)
    return as_recording(
        detections,
        values,
        np.asarray(~(values[..., 2] > 0)),
        confidence=confidence,
        name=str(path),
        video=path.name.partition(".")[0],
        frames=len(images),
        notes=notes,
        default_keypoints=NAMED_BY_COUNT.get(values.shape[1]),
    )
