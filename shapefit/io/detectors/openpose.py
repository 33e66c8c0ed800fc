"""OpenPose's JSON: a file per frame, with the people that were found in it in any order.

Pose2Sim, Sports2D, RTMLib and AlphaPose write the same layout with other numbers of landmarks.
A landmark of 0, 0, 0 is missing. A person is a number from frame to frame only where `person_id`
is not -1. AlphaPose's one file of all images, in the layouts `open` and `cmu`, is
{image: {version, people: [{pose_keypoints_2d}]}} or {image: {version, bodies: [{joints}]}}; the
folder `sep-json` that it writes beside this file has a file for each image.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from shapefit.errors import abbreviate, counted, input_error
from shapefit.io.detectors.coco import labels_of, scaled
from shapefit.io.detectors.detections import Detections, as_recording, images_in
from shapefit.io.detectors.json_text import (
    first_outline,
    outline,
    read_json,
    without_collection,
)
from shapefit.io.foreign.recording import Recording
from shapefit.io.sources import BYTE_ORDER_MARK

PEOPLE = ("people", "bodies")
POSE = ("pose_keypoints_2d", "pose_keypoints", "joints")
OTHERS = ("face_keypoints_2d", "hand_left_keypoints_2d", "hand_right_keypoints_2d")


def is_openpose(path: Path, head: bytes) -> bool:
    """Whether a file, or the first files of a folder, have a list of people."""
    if head:
        own = outline(head)
        return (own.kind == "{" and bool(own.keys & {*PEOPLE})) or own.keys == {"version"}
    return any(own.kind == "{" and own.keys & {*PEOPLE} for own in first_outline(path))


def record(paths: tuple[Path, ...]) -> Recording:
    """Return the frames of a folder, or these files, as one recording."""
    images = images_in(paths, ".json")
    detections = Detections.in_images(images)
    strange: list[str] = []
    further = 0
    for path, part, frame, label in images.files:
        contents = read_json(path)
        people = people_of(contents)
        if people is None:
            strange.append(path.name)
            continue
        for person in people:
            detections.add(keypoints_of(person, path), frame, label, person.get("person_id"), part)
            further += any(person.get(key) for key in OTHERS)
    notes: tuple[str, ...] = ()
    if strange:
        notes += (
            f"{counted(len(strange), 'file')} without people left out ({abbreviate(strange)})",
        )
    if further:
        notes += (f"hands and faces left out, of {counted(further, 'detection')}",)
    values = detections.values()
    return as_recording(
        detections,
        values,
        ~(values[..., 2] > 0),
        confidence=values[..., 2],
        frames=len(images.files) - len(strange),
        notes=notes,
    )


def people_of(contents: Any) -> Sequence[Any] | None:
    """Return the people of a frame; None where the file is not of this kind."""
    if not isinstance(contents, dict):
        return None
    for key in PEOPLE:
        people = contents.get(key)
        if isinstance(people, list):
            return people
        if key in contents and people is None:
            return ()
    return () if contents.keys() <= {"version", "part_candidates"} else None


def keypoints_of(person: Any, place: str | Path) -> list[float]:
    """Return x, y and confidence of each landmark of a person, as they stand in the file."""
    if not isinstance(person, dict):
        raise input_error(place, "a person that is no object", "check what wrote the file")
    found: Any = next((person[key] for key in POSE if person.get(key) is not None), [])
    if not isinstance(found, list):
        raise input_error(place, "keypoints that are no list", "check what wrote the file")
    if len(found) % 3:
        what = f"a person of {len(found)} numbers, which are not 3 for each landmark"
        raise input_error(place, what, "check what wrote the file")
    return found


_BEGINNING = re.compile(rb'\s*\{\s*"(?:[^"\\]|\\.)*"\s*:\s*\{\s*"(?:version|people|bodies)"\s*:')


def is_alphapose(path: Path, head: bytes) -> bool:
    """Whether a file is an object of images, of which the first has people."""
    return _BEGINNING.match(head.removeprefix(BYTE_ORDER_MARK)) is not None


@without_collection
def record_all(paths: tuple[Path, ...]) -> Recording:
    """Return the people of all images, in the order of the file."""
    path = paths[0]
    found = read_json(path)
    if not isinstance(found, dict):
        raise input_error(path, "is no object of images", "give AlphaPose's results")
    detections = Detections.in_file(path)
    images = list(found)
    labels = labels_of(images)
    for place, (image, contents) in enumerate(found.items()):
        people = people_of(contents)
        if people is None:
            raise input_error(f"{path}: {image}", "no list of people", "give AlphaPose's results")
        for person in people:
            numbers = keypoints_of(person, f"{path}: {image}")
            detections.add(numbers, place, labels[place], person.get("idx"))
    values = detections.values()
    confidence, notes = scaled(values[..., 2], images)
    return as_recording(
        detections,
        values,
        np.asarray(~(values[..., 2] > 0)),
        confidence=confidence,
        frames=len(images),
        notes=notes,
    )
