"""Detections of people and animals: OpenPose, AlphaPose, COCO, MMPose, MediaPipe, YOLO.

Their tools write x, y and a confidence of each landmark, the people of a frame in any order, as a
rule without an identity over frames. They differ in where the people of a frame stand.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from shapefit.errors import input_error, listed
from shapefit.io.layout import UNKNOWN_UNIT
from shapefit.io.readers.poses import (
    FRACTION,
    LAST_NUMBER,
    Poses,
    are_fractions,
    are_series,
    check_names,
    edges_of,
    parsing,
    require,
    video_name,
)
from shapefit.io.readers.text import floats, read_json, read_text
from shapefit.io.skeletons import skeletons_of_size


class Detection(NamedTuple):
    """x, y and confidence of each landmark, none where nothing was seen; the image; who it is."""

    numbers: Sequence[float]
    image: int
    who: Any = None


class Images(NamedTuple):
    """The images of a video, in order: their labels (n), and their positions in it (n).

    name is for messages; `unordered` images are, as far as names say, no frames of a video.
    """

    name: str
    video: str
    labels: Sequence[str]
    frames: Sequence[int]
    unordered: bool = False


# One file per image.


def read_image_files(paths: tuple[Path, ...]) -> Poses:
    """Read a file per frame, with the people in it: OpenPose's, or MMPose's list of instances.

    A landmark of confidence 0 is missing. A person is a number from frame to frame only where
    `person_id` is not -1. Pose2Sim, Sports2D and RTMLib write OpenPose's files, too.
    """
    files, images = _find_images(paths, ".json")
    detections: list[Detection] = []
    for number, file in enumerate(files):
        with parsing(file, "a file of people", "remove it from the folder, or export it again"):
            content = read_json(file)
            people = content if isinstance(content, list) else _people_of(content)
            detections += _detections(people, number)
    return _as_poses(images, detections)


BOX, DATA = 5, "data.yaml"
"""Numbers of a line of YOLO before its landmarks, and the file that says what they are."""


def read_yolo(paths: tuple[Path, ...]) -> Poses:
    """Read YOLO's labels: a line for each detection, in fractions of the image.

    A line is class, centre and size of a box, and x, y and v of each landmark; predictions may end
    in a score and a track. v is 0 for missing, 1 and 2 for placed, or a confidence. `kpt_shape` in
    the data.yaml beside the labels says how many landmarks there are, and whether v is left out:
    then a landmark at 0, 0 is missing. Without data.yaml v is 0, 1, 2, or there are COCO's 17.
    """
    files, images = _find_images(paths, ".txt")
    data = _read_data_yaml(paths[0] if paths[0].is_dir() else paths[0].parent)
    rows: list[tuple[int, list[float]]] = []
    for number, file in enumerate(files):
        for line, text in enumerate(read_text(file).split("\n"), 1):
            with parsing(f"{file}:{line}", "a label of YOLO"):
                if cells := text.partition("#")[0].split():
                    rows.append((number, floats(cells)))
    smallest = min((len(row) for _, row in rows), default=BOX) - BOX
    count, step = data.get("kpt_shape") or (smallest // 3, 3)
    width = BOX + count * step
    detections = []
    for number, row in rows:
        with parsing(files[number], "labels of YOLO", f"check kpt_shape in {DATA}"):
            given = f"a line of {len(row)} numbers, and {count} landmarks take {width}"
            require(step in (2, 3) and len(row) - width in (0, 1, 2), given)
            marked = count == 17 or {*row[BOX + 2 : width : 3]} <= {0, 1, 2}
            require(data or marked, f"no {DATA} beside them, and v is not 0, 1 or 2")
        points = np.reshape(row[BOX:width], (count, step))
        if step == 2:
            points = np.column_stack([points, (points > 0).any(axis=1)])
        who = row[-1] if len(row) == width + 2 else None
        detections.append(Detection(points.ravel().tolist(), number, who))
    names = data.get("kpt_names")
    if isinstance(names, dict):  # a list for each class, of which the first is taken
        names = next(iter(names.values()), None)
    people = not data or data.get("names") in (["person"], {0: "person"})
    usual = None if people and count == 17 else [*map(str, range(count))]
    names = names if isinstance(names, list) and len(names) == count else usual
    return _as_poses(
        images,
        detections,
        scored=any({*one.numbers[2::3]} - {0, 1, 2} for one in detections),
        unit=FRACTION,
        landmark_names=names and tuple(map(str, names)),
        edges=edges_of(data.get("skeleton"), count),
    )


def _read_data_yaml(folder: Path) -> dict[str, Any]:
    """Return the nearest data.yaml in this folder or three above it, {} without; or InputError."""
    from ruamel.yaml import YAML

    folder = folder.resolve()
    paths = (place / DATA for place in (folder, *folder.parents[:3]))
    path = next((path for path in paths if path.is_file()), None)
    with parsing(path or folder, "YAML", "correct it"):
        content = YAML(typ="safe", pure=True).load(path) if path else {}
    return content if isinstance(content, dict) else {}


def _find_images(paths: Sequence[Path], suffix: str) -> tuple[Sequence[Path], Images]:
    """Return the files of a folder that is given as a whole, or these files, in order.

    Where names differ in one number alone it is that of the frame; else each is that of an image.
    Raises InputError for links that lead nowhere, pipes and devices, which cannot be read whole.
    """
    folder, files = paths[0].parent, list(paths)
    if paths[0].is_dir():
        folder = paths[0]
        files = [path for path in folder.iterdir() if path.name.lower().endswith(suffix)]
        files = [path for path in files if not path.is_dir()]
    for file in files:
        if not file.is_file():
            fix = "remove it, or name the files themselves"
            raise input_error(file, "is not a regular file", fix)
    name, video = str(paths[0] if len(files) == 1 else folder), folder.resolve().name
    if not are_series([file.stem for file in files]):
        labels = [file.stem for file in sorted(files)]
        return sorted(files), Images(name, video, labels, range(len(files)), unordered=True)
    numbered = {int(LAST_NUMBER.findall(file.stem)[0][1]): file for file in files}
    numbers = sorted(numbered)
    frames = [number - numbers[0] for number in numbers]
    return [numbered[n] for n in numbers], Images(name, video, [*map(str, numbers)], frames)


# One file of all images.


def read_alphapose(paths: tuple[Path, ...]) -> Poses:
    """Read AlphaPose's one file of all images: {image: {people: [{pose_keypoints_2d}]}}.

    Its layout `cmu` says `bodies` and `joints`. The folder `sep-json` beside it is OpenPose's.
    """
    content = read_json(paths[0])
    detections: list[Detection] = []
    for number, frame in enumerate(content.values()):
        detections += _detections(_people_of(frame), number)
    images = _name_images(paths[0], [*content])._replace(unordered=False)
    return _as_poses(images, detections, alphapose=True)


def read_coco_results(paths: tuple[Path, ...]) -> Poses:
    """Read a list of {image_id, category_id, keypoints, score}, as MMDet and AlphaPose write it.

    Images stand in the order of their first appearance. Confidences are taken as they are; a
    landmark of 0, 0, 0 is missing, others of confidence 0 have no weight.
    """
    detections: list[Detection] = []
    numbers: dict[Any, int] = {}
    for entry in read_json(paths[0]):
        image = numbers.setdefault(entry["image_id"], len(numbers))
        detections += _detections([entry], image, needed=True)
    names = all(isinstance(image, str) for image in numbers)
    images = _name_images(paths[0], [*numbers])
    return _as_poses(images, detections, hide_unscored=False, alphapose=names)


def read_coco_annotations(paths: tuple[Path, ...]) -> Poses:
    """Read what people annotated: images, annotations, and categories with names.

    keypoints are [x, y, v, ...]; v = 0 is missing, whatever the coordinates, 1 hidden and 2
    visible. Categories may have different landmarks: then all names together, in their order.
    """
    content = read_json(paths[0])
    place: dict[str, int] = {}
    columns: dict[Any, list[int]] = {}
    edges: dict[tuple[int, int], None] = {}
    for category in content.get("categories", ()):
        names = category.get("keypoints") or []
        check_names(names, "landmark")
        columns[category["id"]] = here = [place.setdefault(name, len(place)) for name in names]
        pairs = edges_of(category.get("skeleton"), len(names) + 1)  # counted from 1
        edges |= {(here[a - 1], here[b - 1]): None for a, b in pairs if a and b}
    images = content.get("images", ())
    labels = {image["id"]: image.get("file_name") or image["id"] for image in images}
    order = {image: number for number, image in enumerate(labels)}
    detections = []
    for entry in content.get("annotations", ()):
        if keypoints := entry.get("keypoints"):
            image = order.setdefault(entry["image_id"], len(order))
            if place:  # those of the category among those of all
                here, points = columns[entry.get("category_id")], np.zeros((len(place), 3))
                points[here] = np.reshape(keypoints, (len(here), 3))
                keypoints = points.ravel().tolist()
            detections.append(Detection(keypoints, image, entry.get("track_id")))
    return _as_poses(
        _name_images(paths[0], [labels.get(image, image) for image in order]),
        detections,
        scored=False,
        landmark_names=tuple(place) or None,
        edges=tuple(edges),
    )


def read_mmpose_video(paths: tuple[Path, ...]) -> Poses:
    """Read a list of {frame_id, instances}, which may stand as `instance_info` beside `meta_info`.

    An instance has keypoints [[x, y], ...] and keypoint_scores, which are taken as they are; they
    may be a little above 1. `meta_info` has the names, by number, as texts or in a list.
    """
    path, content = paths[0], read_json(paths[0])
    meta: Any = {}
    if isinstance(content, dict):
        meta, content = content.get("meta_info") or {}, content["instance_info"]
    if content and "instances" not in content[0]:
        content = [{"frame_id": 0, "instances": content}]
    detections: list[Detection] = []
    for number, frame in enumerate(content):
        detections += _detections(frame["instances"], number, needed=True)
    names: Any = meta.get("keypoint_id2name")
    if isinstance(names, dict):
        names = [names[str(number)] for number in range(len(names))]
    labels = [str(frame.get("frame_id", number)) for number, frame in enumerate(content)]
    return _as_poses(
        Images(str(path), video_name(path), labels, range(len(labels))),
        detections,
        landmark_names=names and tuple(names),
        edges=edges_of(meta.get("skeleton_links"), len(names or ())),
    )


def _name_images(path: Path, names: Sequence[Any]) -> Images:
    """Return the images of a file, called without folder and ending where that tells them apart."""
    stems = [Path(name).stem if isinstance(name, str) else str(name) for name in names]
    labels = stems if len({*stems}) == len(stems) else [*map(str, names)]
    unordered = not are_series(labels)
    return Images(str(path), video_name(path), labels, range(len(labels)), unordered)


BODIES = ("pose_landmarks", "poseLandmarks", "landmarks", "landmark", "keypoints", "hand_landmarks")
"""Keys of bodies, the first that an object has; landmarks in metres (`world`) are not read."""


def read_mediapipe(paths: tuple[Path, ...]) -> Poses:
    """Read landmarks as MediaPipe gives them: lists of {x, y, z, visibility}.

    Each body is such a list. A frame has one, or a list of them, or an object with them under
    `pose_landmarks` or the like. A file has one frame, a list of them, or an object with `frames`.
    x and y are fractions of the image.
    """
    content = read_json(paths[0])
    if isinstance(content, dict):
        content = content.get("frames") or content.get("results") or [content]
    elif _is_body(content):
        content = [content]
    bodies = [(body, number) for number, frame in enumerate(content) for body in _bodies(frame)]
    names = tuple(str(point.get("name") or "") for point in bodies[0][0]) if bodies else ()
    labels = [*map(str, range(len(content)))]
    return _of_points(paths[0], labels, bodies, names if names and all(names) else None)


def _is_body(content: Any) -> bool:
    return isinstance(content, list) and any(isinstance(p, dict) and "x" in p for p in content)


def _bodies(frame: Any) -> Iterator[list[dict[str, Any]]]:
    """Yield the bodies of a frame; there may be none."""
    if _is_body(frame):
        yield [point if isinstance(point, dict) else {} for point in frame]
    elif isinstance(frame, list):
        for one in frame:
            yield from _bodies(one)
    elif isinstance(frame, dict):
        yield from _bodies(next((frame[key] for key in BODIES if frame.get(key)), None))


def read_named_points(paths: tuple[Path, ...]) -> Poses:
    """Read {frame: {landmark: point}}, or a list of the inner objects, one body per frame.

    A point is [x, y], [x, y, confidence] or {x, y, confidence}; a landmark that a frame lacks is
    missing.
    """
    content = read_json(paths[0])
    frames = content if isinstance(content, dict) else dict(enumerate(content))
    names = tuple(dict.fromkeys(name for frame in frames.values() for name in frame))
    bodies = []
    for number, frame in enumerate(frames.values()):
        points = [frame.get(name) or {} for name in names]
        for place, point in enumerate(points):
            if isinstance(point, list):
                require(len(point) in (2, 3), f"a point of {len(point)} numbers")
                points[place] = dict(zip(("x", "y", "score"), point, strict=False))
        bodies.append((points, number))
    return _of_points(paths[0], [*map(str, frames)], bodies, names)


SCORES = ("visibility", "score", "confidence", "presence")


def _of_points(
    path: Path,
    labels: Sequence[str],
    bodies: Sequence[tuple[Sequence[dict[str, Any]], int]],
    names: tuple[str, ...] | None,
) -> Poses:
    """Return the poses of bodies of points {x, y, visibility or the like}, and the frame of each.

    A point without a confidence has that of 1.
    """
    detections = []
    for body, number in bodies:
        rows = ((point.get("x"), point.get("y"), _first(point, SCORES, 1.0)) for point in body)
        numbers = [math.nan if value is None else value for row in rows for value in row]
        detections.append(Detection(numbers, number))
    images = Images(str(path), video_name(path), labels, range(len(labels)))
    return _as_poses(images, detections, hide_unscored=False, unit=None, landmark_names=names)


# What all have in common.

POSE = ("pose_keypoints_2d", "pose_keypoints", "joints", "keypoints")
WHO = ("person_id", "track_id", "idx")


def _first(content: Mapping[str, Any], keys: Sequence[str], default: Any = None) -> Any:
    """Return the value of the first key that an object has."""
    return next((content[key] for key in keys if content.get(key) is not None), default)


def _people_of(frame: Mapping[str, Any]) -> Any:
    """Return the people of a frame; None where it is not of this kind."""
    empty = frame.keys() <= {"version", "part_candidates"}
    people = (frame[key] or [] for key in ("people", "bodies") if key in frame)
    return next(people, [] if empty else None)


def _detections(people: Any, image: int, *, needed: bool = False) -> list[Detection]:
    """Return the people of an image, who may have no landmarks unless they are `needed`.

    The landmarks of each are x, y, confidence in one list, or [x, y] beside `keypoint_scores`.
    """
    detections = []
    require(isinstance(people, list), "no list of people")
    for person in people:
        numbers = _first(person, POSE)
        require(numbers is not None or not needed, "a person without keypoints")
        require(isinstance(numbers or [], list), "keypoints that are no list")
        numbers = numbers or []
        if numbers and isinstance(numbers[0], list):
            scores = _first(person, ("keypoint_scores",), [1.0] * len(numbers))
            scored = zip(numbers, scores, strict=True)
            numbers = [number for (x, y), score in scored for number in (x, y, score)]
        if len(numbers) % 3:
            require(False, f"a person of {len(numbers)} numbers, not 3 a landmark")
        detections.append(Detection(numbers, image, _first(person, WHO)))
    return detections


def _as_poses(
    images: Images,
    detections: list[Detection],
    *,
    hide_unscored: bool = True,
    scored: bool = True,
    alphapose: bool = False,
    unit: str | None = "px",
    **fields: Any,
) -> Poses:
    """Return detections as poses; without names landmarks are those of the usual skeleton.

    A landmark is missing where it has no number, and to `hide_unscored`, where its confidence is
    not above 0; the others say how sure they are where they are `scored`. AlphaPose states
    confidences of 0 to 6, and newer models of it give 0 to 1: where one is above 2, all are divided
    by 6. Without a unit the points are fractions where they can be. Raises InputError where
    detections have different numbers of landmarks.
    """
    detections = sorted(detections, key=lambda one: one.image)
    sizes = Counter(len(one.numbers) // 3 for one in detections if one.numbers)
    if len(sizes) > 1:
        kinds = [f"{n} detections with {p}" for p, n in sorted(sizes.items())]
        fix = "give the files of each skeleton in a separate call"
        raise input_error(images.name, f"several skeletons: {listed(kinds, 'and')} landmarks", fix)
    notes: tuple[str, ...] = ()
    p = next(iter(sizes), len(fields.get("landmark_names") or ()))
    nothing = [math.nan] * (3 * p)
    values = np.array([one.numbers or nothing for one in detections], np.float64)
    values = values.reshape(len(detections), p, 3)
    values = np.where(np.isfinite(values), values, np.nan)
    points, confidence = values[..., :2], values[..., 2]
    if alphapose and np.nanmax(confidence, initial=0) > 2:
        confidence = confidence / 6
        notes += ("confidences divided by 6, the largest that AlphaPose states",)
    missing = np.isnan(values).any(axis=2) | (hide_unscored & ~(confidence > 0))
    if unit is None:
        fractions = are_fractions(points[np.isfinite(values).all(axis=2)])
        unit = FRACTION if fractions else UNKNOWN_UNIT
        fields["size_needed"] = fractions
    who = [_identity(one.who) for one in detections]
    times = Counter((one.image, name) for one, name in zip(detections, who, strict=True) if name)
    if doubles := sum(number > 1 for number in times.values()):
        # Some tools number the people of each frame anew.
        notes += (f"numbers of people are not used, as {doubles} of them occur twice in a frame",)
        who = [""] * len(who)
    usual = None if fields.get("landmark_names") else skeletons_of_size(p)
    return Poses(
        name=images.name,
        video=images.video,
        points=np.where(missing[..., None], np.nan, points),
        confidence=np.where(missing, 0.0, np.nan_to_num(confidence)) if scored else None,
        frame=np.array([images.frames[one.image] for one in detections], np.int64),
        label=[images.labels[one.image] for one in detections],
        individual=who,
        skeleton=usual[0] if usual else None,
        frame_count=len(images.labels),
        unit=unit,
        unordered=images.unordered,
        notes=notes,
        **fields,
    )


def _identity(who: Any) -> str:
    """Return an identity as text, "" for none: a number, a text, or a list of one of them."""
    while isinstance(who, list) and len(who) == 1:
        who = who[0]
    if isinstance(who, bool) or not isinstance(who, int | float | str):
        return ""
    if isinstance(who, str):
        return who
    return "" if who < 0 or who != who else f"id {who:g}"
