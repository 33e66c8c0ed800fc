"""JSON of detectors of people: OpenPose, AlphaPose, COCO, MMPose, MediaPipe.

All of them write x, y and a confidence of each landmark, people of a frame in any order, as a rule
without an identity over frames. They differ in where the people of a frame stand.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from shapefit.arrays import Floats
from shapefit.errors import abbreviate, counted
from shapefit.io.layout import UNKNOWN_UNIT
from shapefit.io.readers.detections import (
    CHECK,
    Detections,
    Frame,
    as_poses,
    images_in,
    read_json,
)
from shapefit.io.readers.items import are_fractions
from shapefit.io.readers.poses import (
    FRACTION,
    Edges,
    Poses,
    check_names,
    edges_of,
    parsing,
    require,
    video_name,
)

PEOPLE = ("people", "bodies")
POSE = ("pose_keypoints_2d", "pose_keypoints", "joints", "keypoints")
WHO = ("person_id", "track_id", "idx")
OTHERS = ("face_keypoints_2d", "hand_left_keypoints_2d", "hand_right_keypoints_2d")


def _add(
    found: Detections, frame: Any, people: Any, place: str | Path, *, needed: bool = False
) -> None:
    """Add the people of a frame or an image, who may have no landmarks unless they are `needed`.

    The landmarks of each are x, y, confidence in one list, or [x, y] beside `keypoint_scores`.
    """
    with parsing(place, CHECK):
        require(isinstance(people, list), "no list of people")
        for person in people:
            points = next((person[key] for key in POSE if person.get(key) is not None), None)
            require(points is not None or not needed, "a person without keypoints")
            points = [] if points is None else points
            require(isinstance(points, list), "keypoints that are no list")
            if points and isinstance(points[0], list):
                scores = person.get("keypoint_scores")
                scores = [1.0] * len(points) if scores is None else scores
                paired = {*map(len, points)} == {2} and len(scores) == len(points)
                require(paired, "keypoints that are not x and y with a score each")
                scored = zip(points, scores, strict=True)
                points = [number for (x, y), score in scored for number in (x, y, score)]
            require(len(points) % 3 == 0, f"a person of {len(points)} numbers, not 3 a landmark")
            who = next((person[key] for key in WHO if person.get(key) is not None), None)
            found.add(points, frame, who)


def read_openpose(paths: tuple[Path, ...]) -> Poses:
    """Read a file per frame, with the people found in it; Pose2Sim, Sports2D and RTMLib write it.

    A landmark of 0, 0, 0 is missing. A person is a number from frame to frame only where
    `person_id` is not -1.
    """
    images = images_in(paths, ".json")
    found = Detections.in_files(images)
    strange: list[str] = []
    further = 0
    for frame in images.frames:
        people = _people_of(read_json(frame.path))
        if people is None:
            strange.append(frame.path.name)
        else:
            _add(found, frame, people, frame.path)
            further += sum(any(person.get(key) for key in OTHERS) for person in people)
    notes: tuple[str, ...] = ()
    if strange:
        lost = f"{counted(len(strange), 'file')} without people left out ({abbreviate(strange)})"
        notes += (lost,)
    if further:
        notes += (f"hands and faces left out, of {counted(further, 'detection')}",)
    return as_poses(found, len(images.frames) - len(strange), notes=notes)


def _people_of(contents: Any) -> list[Any] | None:
    """Return the people of a frame; None where the file is not of this kind."""
    if not isinstance(contents, dict):
        return None
    for key in PEOPLE:
        if key in contents and isinstance(people := contents[key] or [], list):
            return people
    return [] if contents.keys() <= {"version", "part_candidates"} else None


def read_alphapose(paths: tuple[Path, ...]) -> Poses:
    """Read AlphaPose's one file of all images, in the layouts `open` and `cmu`.

    {image: {version, people: [{pose_keypoints_2d}]}} or {image: {version, bodies: [{joints}]}}; the
    folder `sep-json` beside it has a file for each image, which is OpenPose's layout.
    """
    path = paths[0]
    contents = read_json(path)
    found = Detections.in_file(path)
    for image, frame in contents.items():
        _add(found, image, _people_of(frame), f"{path}: {image}")
    frames = found.in_images((image, image) for image in contents)
    found.unordered = False
    values, notes = _scaled(found.values(), [*contents])
    return as_poses(found, frames, values, notes=notes)


ALPHAPOSE_LARGEST, SURELY_NOT_OF_1 = 6.0, 2.0


def _scaled(values: Floats, images: Sequence[Any]) -> tuple[Floats, tuple[str, ...]]:
    """Bring AlphaPose's confidences (N, p, 3: the last) of COCO's models to 0..1.

    AlphaPose, whose image_id is the name of a file, states a scale of 0 to 6, and newer models of
    it give 0 to 1: where one in such a file is above 2, all are divided by 6.
    """
    named = all(isinstance(image, str) for image in images)
    if not named or not np.nanmax(values[..., 2], initial=0) > SURELY_NOT_OF_1:
        return values, ()
    note = f"confidences divided by {ALPHAPOSE_LARGEST:g}, the largest that AlphaPose states"
    return values / [1.0, 1.0, ALPHAPOSE_LARGEST], (note,)


def read_coco_results(paths: tuple[Path, ...]) -> Poses:
    """Read a list of {image_id, category_id, keypoints, score}, as MMDet and AlphaPose write it.

    Images stand in the order of their first appearance. Confidences are taken as they are; a
    landmark of 0, 0, 0 is missing, others of confidence 0 have no weight.
    """
    path = paths[0]
    found = Detections.in_file(path)
    for number, entry in enumerate(read_json(path)):
        with parsing(f"{path}:[{number}]", "give COCO results of keypoints"):
            require(isinstance(entry["keypoints"], list), "no keypoints")
            image = _image(entry["image_id"])
        _add(found, image, [entry], f"{path}:[{number}]")
    images = list(found.frames)
    frames = found.in_images()
    values, notes = _scaled(found.values(), images)
    missing = np.asarray(~values.any(axis=2) | np.isnan(values).any(axis=2))
    return as_poses(found, frames, values, missing, notes=notes)


def _image(image: Any) -> Any:
    """Return what identifies an image. Raises FormatError for what cannot."""
    require(isinstance(image, int | float | str), f"no image ({str(image)[:40]})")
    return image


def read_coco_annotations(paths: tuple[Path, ...]) -> Poses:
    """Read what people annotated: images, annotations, and categories with names.

    keypoints are [x, y, v, ...]; v = 0 is missing, whatever the coordinates, 1 hidden and 2
    visible. Categories may have different landmarks: then all names together, in their order.
    """
    path = paths[0]
    contents = read_json(path)
    images, annotations, categories = (
        contents.get(key, []) for key in ("images", "annotations", "categories")
    )
    own: dict[Any, list[str]] = {}
    for number, each in enumerate(categories):
        with parsing(f"{path}:categories[{number}]", "give each landmark a name of its own"):
            own[_image(each["id"])] = [*(each.get("keypoints") or [])]
            check_names(own[each["id"]], "landmark")
    names = tuple(dict.fromkeys(name for each in own.values() for name in each))
    columns = {key: [names.index(name) for name in each] for key, each in own.items() if each}
    called: dict[Any, Any] = {}
    for number, each in enumerate(images):
        with parsing(f"{path}:images[{number}]", CHECK):
            called[_image(each["id"])] = each.get("file_name") or each["id"]
    found = Detections.in_file(path)
    without = 0
    for number, entry in enumerate(annotations):
        with parsing(f"{path}:annotations[{number}]", "give x, y and v of each landmark"):
            keypoints = entry.get("keypoints")
            if not isinstance(keypoints, list) or not keypoints:
                without += 1
                continue
            image = _image(entry["image_id"])
            if names:
                keypoints = _spread(keypoints, columns[entry.get("category_id")], len(names))
            found.add(keypoints, image, _identity(entry))
    frames = found.in_images(called.items())
    notes: tuple[str, ...] = ()
    if without:
        notes += (f"{counted(without, 'annotation')} without keypoints left out",)
    if unlisted := frames - len(called):
        notes += (f"{counted(unlisted, 'image')} of annotations not listed among the images",)
    edges = _edges(categories, columns)
    return as_poses(
        found, frames, scored=False, landmark_names=names or None, edges=edges, notes=notes
    )


def _identity(entry: Mapping[str, Any]) -> Any:
    """Return who an annotation is of: CVAT's and sleap-io's stand among its attributes."""
    attributes = entry.get("attributes")
    if "track_id" in entry or not isinstance(attributes, dict):
        return entry.get("track_id")
    return attributes.get("track_id", attributes.get("object_id"))


def _spread(keypoints: list[float], columns: list[int], count: int) -> list[float]:
    """Return keypoints of a category at the places of its landmarks among all."""
    given = f"{len(keypoints)} numbers for {len(columns)} landmarks"
    require(len(keypoints) == 3 * len(columns), given)
    every = [0.0] * (3 * count)
    for number, column in enumerate(columns):
        every[3 * column : 3 * column + 3] = keypoints[3 * number : 3 * number + 3]
    return every


def _edges(categories: list[dict[str, Any]], columns: Mapping[Any, list[int]]) -> Edges:
    """Return the edges of all skeletons, which count landmarks from 1, once each."""
    pairs: dict[tuple[int, int], None] = {}
    for category in categories:
        own = columns.get(category.get("id"), [])
        for a, b in edges_of(category.get("skeleton"), len(own) + 1):
            if a and b:
                pairs[own[a - 1], own[b - 1]] = None
    return tuple(pairs)


def read_mmpose_video(paths: tuple[Path, ...]) -> Poses:
    """Read a list of {frame_id, instances}, which may stand as `instance_info` beside `meta_info`.

    An instance has keypoints [[x, y], ...] and keypoint_scores, which are taken as they are; they
    may be a little above 1. `meta_info` has the names.
    """
    path, meta = paths[0], None
    contents = read_json(path)
    if isinstance(contents, dict):
        meta, contents = contents.get("meta_info"), contents["instance_info"]
    if contents and "instances" not in contents[0]:
        contents = [{"frame_id": 0, "instances": contents}]
    found = Detections.in_file(path)
    for number, frame in enumerate(contents):
        place = f"{path}:[{number}]"
        with parsing(place, CHECK):
            label, people = frame.get("frame_id"), frame["instances"]
        label = str(number if label is None else label)
        _add(found, Frame(path, "", number, label), people, place, needed=True)
    return _of_mmpose(found, len(contents), meta)


def read_mmpose_images(paths: tuple[Path, ...]) -> Poses:
    """Read a list of instances per image: those of a folder, or these files."""
    images = images_in(paths, ".json")
    found = Detections.in_files(images)
    for frame in images.frames:
        _add(found, frame, read_json(frame.path), frame.path, needed=True)
    return _of_mmpose(found, len(images.frames), None)


def _of_mmpose(found: Detections, frames: int, meta: Any) -> Poses:
    """Return the recording; `meta` names landmarks by number, as texts or in a list."""
    values = found.values()
    count = values.shape[1]
    meta = meta if isinstance(meta, dict) else {}
    known = meta.get("keypoint_id2name")
    if isinstance(known, dict):
        known = [known.get(str(number)) for number in range(count)]
    known = known if isinstance(known, list) else []
    named = all(isinstance(name, str) for name in known)
    names = tuple(known) if named and len(known) == len({*known}) == count else None
    edges = edges_of(meta.get("skeleton_links"), count) if names else ()
    return as_poses(found, frames, values, landmark_names=names, edges=edges)


BODIES = (
    *("pose_landmarks", "poseLandmarks", "landmarks", "landmark", "keypoints"),
    *("multi_hand_landmarks", "hand_landmarks", "handLandmarks", "face_landmarks"),
)
"""Keys of bodies, the first that an object has; landmarks in metres (`world`) are not read."""

FRAMES = ("frames", "results")
SCORES = ("visibility", "score", "confidence", "presence")


def read_mediapipe(paths: tuple[Path, ...]) -> Poses:
    """Read landmarks as MediaPipe gives them: lists of {x, y, z, visibility}.

    Each body is such a list. A frame has one, or a list of them, or an object with them under
    `pose_landmarks` or the like. A file has one frame, a list of them, or an object with `frames`.
    x and y are fractions of the image.
    """
    path = paths[0]
    contents = read_json(path)
    if isinstance(contents, dict):
        lists = (contents[key] for key in FRAMES if isinstance(contents.get(key), list))
        contents = next(lists, [contents])
    elif _is_body(contents):
        contents = [contents]
    found = Detections(str(path), video_name(path))
    names: list[Any] = []
    for number, frame in enumerate(contents):
        for body in _bodies(frame):
            numbers = [value for point in body for value in _point(point)]
            found.add(numbers, Frame(path, "", number, str(number)), None)
            names = names or [point.get("name") for point in body]
    values = found.values()
    placed = values[np.isfinite(values).all(axis=2)]
    fractions = are_fractions(placed[:, :2])
    named = all(isinstance(name, str) and name for name in names) and len({*names}) == len(names)
    return as_poses(
        found,
        len(contents),
        values,
        np.asarray(np.isnan(values[..., :2]).any(axis=2)),
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
