"""JSON of detectors of people: OpenPose, AlphaPose, COCO, MMPose, MediaPipe.

All of them write x, y and a confidence of each landmark, people of a frame in any order, as a rule
without an identity over frames.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from shapefit.arrays import Floats
from shapefit.errors import abbreviate, counted, input_error
from shapefit.io.foreign.detections import (
    CHECK,
    Detections,
    Frame,
    as_recording,
    image_key,
    images_in,
    read_json,
)
from shapefit.io.foreign.items import are_fractions
from shapefit.io.foreign.recording import FRACTION, Edges, Recording, edges_of, video_name
from shapefit.io.layout import UNKNOWN_UNIT

PEOPLE = ("people", "bodies")
POSE = ("pose_keypoints_2d", "pose_keypoints", "joints")
OTHERS = ("face_keypoints_2d", "hand_left_keypoints_2d", "hand_right_keypoints_2d")


def read_openpose(paths: tuple[Path, ...]) -> Recording:
    """Read a file per frame, with the people found in it; Pose2Sim, Sports2D and RTMLib write it.

    A landmark of 0, 0, 0 is missing. A person is a number from frame to frame only where
    `person_id` is not -1.
    """
    images = images_in(paths, ".json")
    detections = Detections.in_files(images)
    strange: list[str] = []
    further = 0
    for frame in images.frames:
        people = _people_of(read_json(frame.path))
        if people is None:
            strange.append(frame.path.name)
        for person in people or ():
            detections.add(_keypoints_of(person, frame.path), frame, person.get("person_id"))
            further += any(person.get(key) for key in OTHERS)
    notes: tuple[str, ...] = ()
    if strange:
        lost = f"{counted(len(strange), 'file')} without people left out ({abbreviate(strange)})"
        notes += (lost,)
    if further:
        notes += (f"hands and faces left out, of {counted(further, 'detection')}",)
    values = detections.values()
    scores, frames = values[..., 2], len(images.frames) - len(strange)
    return as_recording(
        detections, values, ~(scores > 0), confidence=scores, frames=frames, notes=notes
    )


def _people_of(contents: Any) -> Sequence[Any] | None:
    """Return the people of a frame; None where the file is not of this kind."""
    if not isinstance(contents, dict):
        return None
    for key in PEOPLE:
        if key in contents and isinstance(people := contents[key] or [], list):
            return people
    return () if contents.keys() <= {"version", "part_candidates"} else None


def _keypoints_of(person: Any, place: str | Path) -> list[float]:
    """Return x, y and confidence of each landmark of a person, as they stand in the file."""
    if not isinstance(person, dict):
        raise input_error(place, "a person that is no object", CHECK)
    found: Any = next((person[key] for key in POSE if person.get(key) is not None), [])
    if not isinstance(found, list):
        raise input_error(place, "keypoints that are no list", CHECK)
    if len(found) % 3:
        what = f"a person of {len(found)} numbers, which are not 3 for each landmark"
        raise input_error(place, what, CHECK)
    return found


def read_alphapose(paths: tuple[Path, ...]) -> Recording:
    """Read AlphaPose's one file of all images, in the layouts `open` and `cmu`.

    {image: {version, people: [{pose_keypoints_2d}]}} or {image: {version, bodies: [{joints}]}}; the
    folder `sep-json` beside it has a file for each image, which is OpenPose's layout.
    """
    path, fix = paths[0], "give AlphaPose's results"
    found = read_json(path)
    if not isinstance(found, dict):
        raise input_error(path, "is no object of images", fix)
    detections = Detections.in_file(path)
    for image, contents in found.items():
        people = _people_of(contents)
        if people is None:
            raise input_error(f"{path}: {image}", "no list of people", fix)
        for person in people:
            detections.add(_keypoints_of(person, f"{path}: {image}"), image, person.get("idx"))
    frames = detections.in_images((image, image) for image in found)
    detections.unordered = False
    values = detections.values()
    confidence, notes = _scaled(values[..., 2], [*found])
    missing = np.asarray(~(values[..., 2] > 0))
    return as_recording(
        detections, values, missing, confidence=confidence, frames=frames, notes=notes
    )


ALPHAPOSE_LARGEST, SURELY_NOT_OF_1 = 6.0, 2.0


def _scaled(confidence: Floats, images: Sequence[Any]) -> tuple[Floats, tuple[str, ...]]:
    """Bring AlphaPose's confidences of COCO's models to 0..1.

    AlphaPose, whose image_id is the name of a file, states a scale of 0 to 6, and newer models of
    it give 0 to 1: where one in such a file is above 2, all are divided by 6.
    """
    named = all(isinstance(image, str) for image in images)
    if not named or not confidence.size or not np.nanmax(confidence, initial=0) > SURELY_NOT_OF_1:
        return confidence, ()
    note = f"confidences divided by {ALPHAPOSE_LARGEST:g}, the largest that AlphaPose states"
    return confidence / ALPHAPOSE_LARGEST, (note,)


def read_coco_results(paths: tuple[Path, ...]) -> Recording:
    """Read a list of {image_id, category_id, keypoints, score}, as MMDet and AlphaPose write it.

    Images stand in the order of their first appearance. Confidences are taken as they are; a
    landmark of 0, 0, 0 is missing, others of confidence 0 have no weight.
    """
    path = paths[0]
    found = read_json(path)
    if not isinstance(found, list):
        raise input_error(path, "is no list of results", "give COCO results")
    detections = Detections.in_file(path)
    for number, entry in enumerate(found):
        place = f"{path}:[{number}]"
        if not isinstance(entry, dict) or not isinstance(entry.get("keypoints"), list):
            raise input_error(place, "no keypoints", "give COCO results of keypoints")
        image = image_key(entry.get("image_id"), place)
        detections.add(entry["keypoints"], image, entry.get("track_id", entry.get("idx")))
    images = list(detections.frames)
    frames = detections.in_images()
    values = detections.values()
    confidence, notes = _scaled(values[..., 2], images)
    missing = np.asarray(~values.any(axis=2) | np.isnan(values).any(axis=2))
    return as_recording(
        detections, values, missing, confidence=confidence, frames=frames, notes=notes
    )


def read_coco_annotations(paths: tuple[Path, ...]) -> Recording:
    """Read what people annotated: images, annotations, and categories with names.

    keypoints are [x, y, v, ...]; v = 0 is missing, whatever the coordinates, 1 hidden and 2
    visible. Categories may have different landmarks: then all names together, in their order.
    """
    path = paths[0]
    found = read_json(path)
    images, annotations, categories = (
        _objects(found, key, path) for key in ("images", "annotations", "categories")
    )
    place = f"{path}:categories"
    own = {image_key(each.get("id"), place): _category_names(each, place) for each in categories}
    names = tuple(dict.fromkeys(name for each in own.values() for name in each))
    columns = {key: [names.index(name) for name in each] for key, each in own.items() if each}
    called = {
        image_key(image.get("id"), f"{path}:images"): image.get("file_name") or image["id"]
        for image in images
    }
    detections = Detections.in_file(path)
    without = 0
    for number, entry in enumerate(annotations):
        keypoints, category = entry.get("keypoints"), entry.get("category_id")
        if not isinstance(keypoints, list) or not keypoints:
            without += 1
            continue
        place = f"{path}:annotations[{number}]"
        image = image_key(entry.get("image_id"), place)
        if names:
            mine = columns.get(category) if isinstance(category, int | float | str) else None
            keypoints = _spread(keypoints, mine, len(names), place)
        detections.add(keypoints, image, _identity(entry))
    frames = detections.in_images(called.items())
    notes: tuple[str, ...] = ()
    if without:
        notes += (f"{counted(without, 'annotation')} without keypoints left out",)
    if unlisted := frames - len(called):
        notes += (f"{counted(unlisted, 'image')} of annotations not listed among the images",)
    values = detections.values()
    return as_recording(
        detections,
        values,
        ~(values[..., 2] > 0),
        frames=frames,
        landmark_names=names or None,
        edges=_edges(categories, columns),
        notes=notes,
    )


def _objects(found: Any, key: str, path: Path) -> list[dict[str, Any]]:
    """Return the list of objects of a name; none where the file lacks it."""
    entries = found.get(key, []) if isinstance(found, dict) else None
    if not isinstance(entries, list) or not all(isinstance(one, dict) for one in entries):
        raise input_error(f"{path}:{key}", "is no list of objects", "give COCO annotations")
    return entries


def _category_names(category: dict[str, Any], place: str) -> list[str]:
    """Return the landmarks of a category."""
    names = category.get("keypoints") or []
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        raise input_error(place, "keypoints that are no names", "give their names")
    if len(set(names)) < len(names):
        found = f"landmarks of {category.get('name')!r} with the same name"
        raise input_error(place, found, "give every landmark a unique name")
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
    every = [0.0] * (3 * count)
    for number, column in enumerate(columns):
        every[3 * column : 3 * column + 3] = keypoints[3 * number : 3 * number + 3]
    return every


def _edges(categories: list[dict[str, Any]], columns: dict[Any, list[int]]) -> Edges:
    """Return the edges of all skeletons, which count landmarks from 1, once each."""
    pairs: dict[tuple[int, int], None] = {}
    for category in categories:
        own = columns.get(category.get("id"), [])
        for a, b in edges_of(category.get("skeleton"), len(own) + 1):
            if a and b:
                pairs[own[a - 1], own[b - 1]] = None
    return tuple(pairs)


MMPOSE_FIX = "give the predictions of MMPose's inferencer"


def read_mmpose_video(paths: tuple[Path, ...]) -> Recording:
    """Read a list of {frame_id, instances}, which may stand as `instance_info` beside `meta_info`.

    An instance has keypoints [[x, y], ...] and keypoint_scores, which are taken as they are; they
    may be a little above 1. `meta_info` has the names.
    """
    path, meta = paths[0], None
    found = read_json(path)
    if isinstance(found, dict):
        meta, found = found.get("meta_info"), found.get("instance_info")
    if not isinstance(found, list):
        raise input_error(path, "no list of instances", MMPOSE_FIX)
    if found and isinstance(found[0], dict) and "instances" not in found[0]:
        found = [{"frame_id": 0, "instances": found}]
    detections = Detections.in_file(path, step=2)
    for number, frame in enumerate(found):
        instances = frame.get("instances") if isinstance(frame, dict) else None
        if not isinstance(instances, list):
            raise input_error(f"{path}:[{number}]", "a frame without `instances`", MMPOSE_FIX)
        label = frame.get("frame_id")
        label = str(number if label is None else label)
        _add_people(detections, instances, Frame(path, "", number, label))
    return _of_mmpose(detections, len(found), meta)


def read_mmpose_images(paths: tuple[Path, ...]) -> Recording:
    """Read a list of instances per image: those of a folder, or these files."""
    images = images_in(paths, ".json")
    detections = Detections.in_files(images, step=2)
    for frame in images.frames:
        instances = read_json(frame.path)
        if not isinstance(instances, list):
            raise input_error(frame.path, "no list of instances, as the other files", MMPOSE_FIX)
        _add_people(detections, instances, frame)
    return _of_mmpose(detections, len(images.frames), None)


def _add_people(detections: Detections, instances: list[Any], frame: Frame) -> None:
    """Add the people of a frame, as x, y and score of each landmark."""
    for number, instance in enumerate(instances):
        place = f"{frame.path}: frame {frame.label}, instance {number}"
        points = instance.get("keypoints") if isinstance(instance, dict) else None
        if not isinstance(points, list):
            raise input_error(place, "no keypoints", MMPOSE_FIX)
        scores = instance.get("keypoint_scores")
        if scores is None:
            scores = [1.0] * len(points)
        widths = {len(point) if isinstance(point, list) else 0 for point in points}
        if not widths <= {2} or not isinstance(scores, list) or len(scores) != len(points):
            found = f"{len(points)} keypoints that are not x and y with a score each"
            found = "3D keypoints" if widths == {3} else found
            raise input_error(place, found, "give predictions of 2D landmarks")
        detections.scores.append(scores)
        detections.add([*chain.from_iterable(points)], frame, instance.get("track_id"))


def _of_mmpose(detections: Detections, frames: int, meta: Any) -> Recording:
    """Return the recording; `meta` names landmarks by number, as texts or in a list."""
    values, scores = detections.values(), detections.confidence()
    count = values.shape[1]
    known = meta.get("keypoint_id2name") if isinstance(meta, dict) else None
    if isinstance(known, dict):
        known = [known.get(str(number)) for number in range(count)]
    known = known if isinstance(known, list) else []
    named = all(isinstance(name, str) for name in known)
    names = tuple(known) if named and len(known) == len({*known}) == count else None
    return as_recording(
        detections,
        values,
        np.isnan(values).any(axis=2) | ~(scores > 0),
        confidence=scores,
        frames=frames,
        landmark_names=names,
        edges=edges_of(meta.get("skeleton_links"), count) if names else (),
    )


BODIES = (
    *("pose_landmarks", "poseLandmarks", "landmarks", "landmark", "keypoints"),
    *("multi_hand_landmarks", "hand_landmarks", "handLandmarks", "face_landmarks"),
)
"""Keys of bodies, the first that an object has; landmarks in metres (`world`) are not read."""

FRAMES = ("frames", "results")
SCORES = ("visibility", "score", "confidence", "presence")


def read_mediapipe(paths: tuple[Path, ...]) -> Recording:
    """Read landmarks as MediaPipe gives them: lists of {x, y, z, visibility}.

    Each body is such a list. A frame has one, or a list of them, or an object with them under
    `pose_landmarks` or the like. A file has one frame, a list of them, or an object with `frames`.
    x and y are fractions of the image. Raises InputError for what are no points.
    """
    path = paths[0]
    found = read_json(path)
    if isinstance(found, dict):
        found = next((found[key] for key in FRAMES if isinstance(found.get(key), list)), [found])
    elif _is_body(found):
        found = [found]
    if not isinstance(found, list):
        raise input_error(path, "is no list of frames", "give MediaPipe's landmarks")
    detections = Detections(str(path), video_name(path))
    names: list[Any] = []
    for number, frame in enumerate(found):
        for body in _bodies(frame):
            numbers = [value for point in body for value in _point(point)]
            detections.add(numbers, Frame(path, "", number, str(number)), None)
            names = names or [point.get("name") for point in body]
    values = detections.values()
    placed = values[np.isfinite(values).all(axis=2)]
    fractions = are_fractions(placed[:, :2])
    named = all(isinstance(name, str) and name for name in names) and len({*names}) == len(names)
    return as_recording(
        detections,
        values,
        np.asarray(np.isnan(values[..., :2]).any(axis=2)),
        confidence=np.nan_to_num(values[..., 2]),
        frames=len(found),
        unit=FRACTION if fractions else UNKNOWN_UNIT,
        size_needed=fractions,
        landmark_names=tuple(names) if named and names else None,
    )


def _is_body(found: Any) -> bool:
    return isinstance(found, list) and any(isinstance(one, dict) and "x" in one for one in found)


def _bodies(frame: Any) -> Iterator[list[dict[str, Any]]]:
    """Yield the bodies of a frame; there may be none."""
    if _is_body(frame):
        yield [point if isinstance(point, dict) else {} for point in frame]
    elif isinstance(frame, list):
        for one in frame:
            yield from _bodies(one)
    elif isinstance(frame, dict):
        yield from _bodies(next((frame[key] for key in BODIES if frame.get(key)), None))


def _point(point: dict[str, Any]) -> list[Any]:
    """Return x, y and confidence of a point, NaN for what it does not say."""
    score = next((point[key] for key in SCORES if point.get(key) is not None), 1.0)
    known = [point.get("x"), point.get("y"), score]
    return [math.nan if value is None else value for value in known]
