"""COCO keypoints: results, as detectors write them, and annotations, as people make them.

Results are a bare list of detections without names, as MMDet and AlphaPose write it:
{image_id, category_id, keypoints [x, y, confidence, ...], score}. Confidences are taken as they
are; a landmark of 0, 0, 0 is missing, others of confidence 0 have no weight. AlphaPose, whose
image_id is the name of a file, states a scale of 0 to 6 for models of COCO, and newer models of it
give 0 to 1: where one in such a file is above 2, all are divided by 6.

Annotations have images, annotations, and categories with names. keypoints are [x, y, v, ...]; v = 0
is missing, whatever the coordinates, 1 hidden and 2 visible. Categories may have different
landmarks: then all names together, in the order of categories.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from shapefit.arrays import Floats
from shapefit.errors import counted, input_error
from shapefit.io.detectors.detections import (
    Detections,
    are_series,
    as_recording,
    edges_of,
    image_key,
    numbered,
)
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
def record_results(paths: tuple[Path, ...]) -> Recording:
    """Return the detections of a file, images in the order of their first appearance."""
    path = paths[0]
    found = read_json(path)
    if not isinstance(found, list):
        raise input_error(path, "is no list of results", "give COCO results")
    detections = Detections.in_file(path)
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
    detections.unordered = not are_series(names)
    values = detections.values()
    confidence, notes = scaled(values[..., 2], order)
    return as_recording(
        detections,
        values,
        np.asarray(~values.any(axis=2) | np.isnan(values).any(axis=2)),
        confidence=confidence,
        frames=len(order),
        notes=notes,
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


def is_coco_annotations(path: Path, head: bytes) -> bool:
    """Whether a file is an object with images, annotations or categories."""
    own = outline(head)
    return own.kind == "{" and bool(
        own.keys & {"images", "annotations", "categories", "licenses"}
        or ("info" in own.keys and "people" not in own.keys)
    )


@without_collection
def record_annotations(paths: tuple[Path, ...]) -> Recording:
    """Return the annotations of a file, images in its order."""
    path = paths[0]
    found = read_json(path)
    images, annotations, categories = (_objects(found, key, path) for key in _PARTS)
    place_of = {key: f"{path}:{key}" for key in _PARTS}
    own = {
        image_key(entry.get("id"), place_of["categories"]): _names(entry, str(path))
        for entry in categories
    }
    names = tuple(dict.fromkeys(name for each in own.values() for name in each or ()))
    place = {name: number for number, name in enumerate(names)}
    columns = {key: [place[name] for name in each] for key, each in own.items() if each}

    frames = {
        image_key(image.get("id"), place_of["images"]): number
        for number, image in enumerate(images)
    }
    called = [image.get("file_name") or image["id"] for image in images]
    detections = Detections.in_file(path)
    without = unlisted = 0
    for number, entry in enumerate(annotations):
        keypoints = entry.get("keypoints")
        if not isinstance(keypoints, list) or not keypoints:
            without += 1
            continue
        image = image_key(entry.get("image_id"), f"{path}:annotations[{number}]")
        if image not in frames:
            frames[image] = len(called)
            called.append(image)
            unlisted += 1
        category = entry.get("category_id")
        mine = columns.get(category) if isinstance(category, int | float | str) else None
        detections.numbers.append(
            _spread(keypoints, mine, len(names), f"{path}:annotations[{number}]")
            if names
            else keypoints
        )
        detections.frames.append(frames[image])
        detections.identities.append(_identity(entry))
    labels = labels_of(called)
    detections.labels = [labels[frame] for frame in detections.frames]
    detections.unordered = not are_series(labels)
    values = detections.values()
    notes: tuple[str, ...] = ()
    if without:
        notes += (f"{counted(without, 'annotation')} without keypoints left out",)
    if unlisted:
        notes += (f"{counted(unlisted, 'image')} of annotations not listed among the images",)
    return as_recording(
        detections,
        values,
        ~(values[..., 2] > 0),
        frames=len(called),
        landmark_names=names or None,
        edges=_edges(categories, columns),
        notes=notes,
    )


_PARTS = ("images", "annotations", "categories")


def _objects(found: Any, key: str, path: Path) -> list[dict[str, Any]]:
    """Return the list of objects of a name; none where the file lacks it."""
    entries = found.get(key, []) if isinstance(found, dict) else None
    if not isinstance(entries, list) or not all(isinstance(one, dict) for one in entries):
        raise input_error(f"{path}:{key}", "is no list of objects", "give COCO annotations")
    return entries


def _names(category: dict[str, Any], place: str) -> list[str] | None:
    """Return the landmarks of a category, None where it has none."""
    names = category.get("keypoints")
    if not names:
        return None
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        raise input_error(f"{place}:categories", "keypoints that are no names", "give their names")
    if len(set(names)) < len(names):
        found = f"landmarks of {category.get('name')!r} with the same name"
        raise input_error(f"{place}:categories", found, "give every landmark a unique name")
    return names


def _identity(entry: dict[str, Any]) -> Any:
    """Return who an annotation is of: CVAT's and sleap-io's stand among its attributes."""
    attributes = entry.get("attributes")
    if "track_id" in entry or not isinstance(attributes, dict):
        return entry.get("track_id")
    return attributes.get("track_id", attributes.get("object_id"))


def _spread(
    keypoints: list[float], columns: list[int] | None, count: int, place: str
) -> list[float]:
    """Return keypoints of a category at the places of its landmarks among all."""
    if columns is None:
        raise input_error(place, "a category without landmarks", "name them in `categories`")
    if len(keypoints) != 3 * len(columns):
        found = f"{len(keypoints)} numbers for {len(columns)} landmarks"
        raise input_error(place, found, "give x, y and v of each landmark of its category")
    if columns == list(range(count)):
        return keypoints
    every = [0.0] * (3 * count)
    for number, column in enumerate(columns):
        every[3 * column : 3 * column + 3] = keypoints[3 * number : 3 * number + 3]
    return every


def _edges(
    categories: list[dict[str, Any]], columns: dict[Any, list[int]]
) -> tuple[tuple[int, int], ...]:
    """Return the edges of all skeletons, which count landmarks from 1, once each."""
    pairs: dict[tuple[int, int], None] = {}
    for category in categories:
        own = columns.get(category.get("id"), [])
        for a, b in edges_of(category.get("skeleton"), len(own) + 1):
            if a and b:
                pairs[own[a - 1], own[b - 1]] = None
    return tuple(pairs)
