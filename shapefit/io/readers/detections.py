"""Detections of people and animals: OpenPose, AlphaPose, COCO, MMPose, MediaPipe, YOLO.

Their tools write x, y and a confidence of each landmark, the people of a frame in any order, as a
rule without an identity over frames. They differ in where the people of a frame stand.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from shapefit.errors import abbreviate, counted, input_error, listed
from shapefit.io.inputs import read_whole
from shapefit.io.layout import UNKNOWN_UNIT
from shapefit.io.readers.columns import decode
from shapefit.io.readers.images import Images, find_images, name_images, number_images
from shapefit.io.readers.json_file import read_json
from shapefit.io.readers.poses import (
    FRACTION,
    Edges,
    Poses,
    are_fractions,
    check_names,
    edges_of,
    find_yaml,
    parsing,
    require,
    to_numbers,
    video_name,
)
from shapefit.io.skeletons import skeletons_of_size

CHECK = "check what wrote the file"


class Detection(NamedTuple):
    """x, y and confidence of each landmark, none where nothing was found; the image; who it is."""

    numbers: Sequence[float]
    image: int
    who: Any = None


# One file per image.

OTHERS = ("face_keypoints_2d", "hand_left_keypoints_2d", "hand_right_keypoints_2d")


def read_image_files(paths: tuple[Path, ...]) -> Poses:
    """Read a file per frame, with the people in it: OpenPose's, or MMPose's list of instances.

    A landmark of confidence 0 is missing. A person is a number from frame to frame only where
    `person_id` is not -1. Pose2Sim, Sports2D and RTMLib write OpenPose's files, too.
    """
    files, images = find_images(paths, ".json")
    detections: list[Detection] = []
    without_people: list[str] = []
    further = 0
    for number, file in enumerate(files):
        contents = read_json(file)
        people = contents if isinstance(contents, list) else _people_of(contents)
        if people is None:
            without_people.append(file.name)
        else:
            detections += _detections(people, number, file, needed=people is contents)
            further += sum(any(person.get(key) for key in OTHERS) for person in people)
    notes: tuple[str, ...] = ()
    if without_people:
        files_left = f"{counted(len(without_people), 'file')} without people left out"
        notes += (f"{files_left} ({abbreviate(without_people)})",)
    if further:
        notes += (f"hands and faces left out, of {counted(further, 'detection')}",)
    return as_poses(images, detections, notes=notes, frame_count=len(files) - len(without_people))


def read_yolo(paths: tuple[Path, ...]) -> Poses:
    """Read YOLO's labels: a line for each detection, in fractions of the image.

    A line is class, centre and size of a box, and x, y and mostly v of each landmark; predictions
    may end in a score and a track. `kpt_shape` in the data.yaml beside the labels says how many
    landmarks there are, and whether v is given: 0 is missing, 1 and 2 are placed, fractions are
    confidences. Without v, a landmark at 0, 0 is missing.
    """
    files, images = find_images(paths, ".txt", but="classes.txt")
    rows: list[tuple[int, list[float]]] = []
    for number, file in enumerate(files):
        for line, text in enumerate(decode(read_whole(file)).splitlines(), start=1):
            with parsing(f"{file}:{line}", "give labels of poses"):
                if cells := text.partition("#")[0].split():
                    rows.append((number, to_numbers(cells)))
    layout = _read_layout(paths[0] if paths[0].is_dir() else paths[0].parent)
    layout = layout or _guess_layout([row for _, row in rows], images.name)
    count, step = layout.landmarks, layout.step
    width = BOX + count * step
    detections = []
    for number, row in rows:
        with parsing(files[number], f"check kpt_shape in {DATA}"):
            given = f"a line of {len(row)} numbers, and {count} landmarks take {width}"
            require(len(row) - width in (0, 1, 2), given)
        numbers = row[BOX:width]
        if step == 2:
            points = zip(numbers[::2], numbers[1::2], strict=True)
            numbers = [value for x, y in points for value in (x, y, float(x > 0 or y > 0))]
        detections.append(Detection(numbers, number, row[-1] if len(row) == width + 2 else None))
    usual = None if layout.people and count == 17 else tuple(map(str, range(count)))
    return as_poses(
        images,
        detections,
        scored=any({*one.numbers[2::3]} - {0, 1, 2} for one in detections),
        unit=FRACTION,
        landmark_names=layout.names or usual,
        edges=layout.edges,
    )


BOX, DATA = 5, "data.yaml"
"""Numbers of a line of YOLO before its landmarks, and the file that says what they are."""


class Layout(NamedTuple):
    """Landmarks of a line, numbers of each, and what data.yaml calls landmarks and classes."""

    landmarks: int
    step: int
    names: tuple[str, ...] | None = None
    people: bool = False
    edges: Edges = ()


def _read_layout(folder: Path) -> Layout | None:
    """Return what the nearest data.yaml in this folder or three above it states."""
    path, content = find_yaml(folder, DATA, 3) or (folder, None)
    if not isinstance(content, dict) or (shape := content.get("kpt_shape")) is None:
        return None
    whole = isinstance(shape, list) and len(shape) == 2 and all(type(n) is int for n in shape)
    if not whole or not 0 < shape[0] < 10_000 or shape[1] not in (2, 3):
        raise input_error(path, f"kpt_shape is {shape}", "give [landmarks, 2] or [landmarks, 3]")
    names: Any = content.get("kpt_names")
    classes = content.get("names")
    if isinstance(names, dict):  # a list for each class, of which the first is taken
        names = next(iter(names.values()), None)
    named = isinstance(names, list) and len(names) == len({*map(str, names)}) == shape[0]
    people = (list(classes.values()) if isinstance(classes, dict) else classes) == ["person"]
    texts = tuple(map(str, names)) if named else None
    return Layout(shape[0], shape[1], texts, people, edges_of(content.get("skeleton"), shape[0]))


def _guess_layout(rows: list[list[float]], name: str) -> Layout:
    """Return the layout that lines have where no data.yaml states it."""
    if not rows:
        return Layout(0, 3)
    smallest = min(len(row) - BOX for row in rows)
    threes = [m for m in (smallest, smallest - 1, smallest - 2) if m > 0 and m % 3 == 0]
    for length in threes:
        marks = {v for row in rows for v in row[BOX + 2 : BOX + length : 3]}
        if marks <= {0, 1, 2} or length == 51:
            return Layout(length // 3, 3, people=length == 51)
    if smallest % 2 == 0 and smallest % 3:
        return Layout(smallest // 2, 2)
    problem = f"lines of {smallest} numbers after the box, and no {DATA} with kpt_shape beside them"
    raise input_error(name, problem, f"put the {DATA} of the data set beside the labels")


# One file of all images.


def read_alphapose(paths: tuple[Path, ...]) -> Poses:
    """Read AlphaPose's one file of all images: {image: {people: [{pose_keypoints_2d}]}}.

    Its layout `cmu` says `bodies` and `joints`. The folder `sep-json` beside it is OpenPose's.
    """
    contents = read_json(paths[0])
    detections: list[Detection] = []
    for number, (image, frame) in enumerate(contents.items()):
        detections += _detections(_people_of(frame), number, f"{paths[0]}: {image}")
    images = name_images(paths[0], [*contents])._replace(unordered=False)
    return as_poses(images, detections, alphapose=True)


def read_coco_results(paths: tuple[Path, ...]) -> Poses:
    """Read a list of {image_id, category_id, keypoints, score}, as MMDet and AlphaPose write it.

    Images stand in the order of their first appearance. Confidences are taken as they are; a
    landmark of 0, 0, 0 is missing, others of confidence 0 have no weight.
    """
    detections: list[Detection] = []
    numbers: dict[Any, int] = {}
    for row, entry in enumerate(read_json(paths[0])):
        place = f"{paths[0]}:[{row}]"
        with parsing(place, "give COCO results of keypoints"):
            require(isinstance(entry["keypoints"], list), "no keypoints")
            image = numbers.setdefault(_identifier(entry["image_id"]), len(numbers))
        detections += _detections([entry], image, place)
    names = all(isinstance(image, str) for image in numbers)
    images = name_images(paths[0], [*numbers])
    return as_poses(images, detections, missing="at origin", alphapose=names)


def read_coco_annotations(paths: tuple[Path, ...]) -> Poses:
    """Read what people annotated: images, annotations, and categories with names.

    keypoints are [x, y, v, ...]; v = 0 is missing, whatever the coordinates, 1 hidden and 2
    visible. Categories may have different landmarks: then all names together, in their order.
    """
    path, contents = paths[0], read_json(paths[0])
    names_of: dict[Any, list[str]] = {}
    for number, category in enumerate(contents.get("categories", ())):
        with parsing(f"{path}:categories[{number}]", "give each landmark a name of its own"):
            names_of[_identifier(category["id"])] = names = [*(category.get("keypoints") or [])]
            check_names(names, "landmark")
    place: dict[str, int] = {}
    for names in names_of.values():
        place |= {name: len(place) + n for n, name in enumerate(x for x in names if x not in place)}
    called: dict[Any, Any] = {}
    for number, image in enumerate(contents.get("images", ())):
        with parsing(f"{path}:images[{number}]", CHECK):
            called[_identifier(image["id"])] = image.get("file_name") or image["id"]
    order = {image: number for number, image in enumerate(called)}
    detections = []
    without = 0
    for number, entry in enumerate(contents.get("annotations", ())):
        with parsing(f"{path}:annotations[{number}]", "give x, y and v of each landmark"):
            keypoints, attributes = entry.get("keypoints"), entry.get("attributes")
            if not isinstance(keypoints, list) or not keypoints:
                without += 1
                continue
            image = order.setdefault(_identifier(entry["image_id"]), len(order))
            if place:  # those of the category among those of all
                names, given = names_of[entry.get("category_id")], keypoints
                require(names, "keypoints of a category without any")
                count = f"{len(given)} numbers for {len(names)} landmarks"
                require(len(given) == 3 * len(names), count)
                keypoints = [0.0] * (3 * len(place))
                for n, name in enumerate(names):
                    at = 3 * place[name]
                    keypoints[at : at + 3] = given[3 * n : 3 * n + 3]
            who = entry.get("track_id")
            if "track_id" not in entry and isinstance(attributes, dict):  # CVAT's and sleap-io's
                who = attributes.get("track_id", attributes.get("object_id"))
            detections.append(Detection(keypoints, image, who))
    notes: tuple[str, ...] = ()
    if without:
        notes += (f"{counted(without, 'annotation')} without keypoints left out",)
    if unlisted := len(order) - len(called):
        notes += (f"{counted(unlisted, 'image')} of annotations not listed among the images",)
    edges: dict[tuple[int, int], None] = {}
    for category in contents.get("categories", ()):  # which count landmarks from 1
        names = names_of[category["id"]]
        lines = edges_of(category.get("skeleton"), len(names) + 1)
        edges |= {(place[names[a - 1]], place[names[b - 1]]): None for a, b in lines if a and b}
    return as_poses(
        name_images(path, [called.get(image, image) for image in order]),
        detections,
        scored=False,
        landmark_names=tuple(place) or None,
        edges=tuple(edges),
        notes=notes,
    )


def _identifier(value: Any) -> Any:
    """Return what identifies an image or category. Raises FormatError for what cannot."""
    require(isinstance(value, int | float | str), f"no image ({str(value)[:40]})")
    return value


def read_mmpose_video(paths: tuple[Path, ...]) -> Poses:
    """Read a list of {frame_id, instances}, which may stand as `instance_info` beside `meta_info`.

    An instance has keypoints [[x, y], ...] and keypoint_scores, which are taken as they are; they
    may be a little above 1. `meta_info` has the names, by number, as texts or in a list.
    """
    path, contents = paths[0], read_json(paths[0])
    meta: Any = {}
    if isinstance(contents, dict):
        meta, contents = contents.get("meta_info"), contents["instance_info"]
        meta = meta if isinstance(meta, dict) else {}
    if contents and "instances" not in contents[0]:
        contents = [{"frame_id": 0, "instances": contents}]
    detections: list[Detection] = []
    labels = []
    for number, frame in enumerate(contents):
        with parsing(f"{path}:[{number}]", CHECK):
            label, people = frame.get("frame_id"), frame["instances"]
        labels.append(str(number if label is None else label))
        detections += _detections(people, number, f"{path}:[{number}]", needed=True)
    count = next((len(one.numbers) // 3 for one in detections if one.numbers), 0)
    texts: Any = meta.get("keypoint_id2name")
    texts = [texts.get(str(n)) for n in range(count)] if isinstance(texts, dict) else texts
    named = isinstance(texts, list) and all(isinstance(name, str) for name in texts)
    names = tuple(texts) if named and len(texts) == len({*texts}) == count else None
    edges = edges_of(meta.get("skeleton_links"), count) if names else ()
    images = number_images(path, path.name.partition(".")[0], labels)
    return as_poses(images, detections, landmark_names=names, edges=edges)


BODIES = (
    *("pose_landmarks", "poseLandmarks", "landmarks", "landmark", "keypoints"),
    *("multi_hand_landmarks", "hand_landmarks", "handLandmarks", "face_landmarks"),
)
"""Keys of bodies, the first that an object has; landmarks in metres (`world`) are not read."""


def read_mediapipe(paths: tuple[Path, ...]) -> Poses:
    """Read landmarks as MediaPipe gives them: lists of {x, y, z, visibility}.

    Each body is such a list. A frame has one, or a list of them, or an object with them under
    `pose_landmarks` or the like. A file has one frame, a list of them, or an object with `frames`.
    x and y are fractions of the image.
    """
    contents = read_json(paths[0])
    if isinstance(contents, dict):
        lists = (contents.get(key) for key in ("frames", "results"))
        contents = next((frames for frames in lists if isinstance(frames, list)), [contents])
    elif _is_body(contents):
        contents = [contents]
    bodies = [(body, n) for n, frame in enumerate(contents) for body in _bodies(frame)]
    names: tuple[Any, ...] = tuple(p.get("name") for p in bodies[0][0]) if bodies else ()
    named = all(isinstance(name, str) and name for name in names) and len({*names}) == len(names)
    labels = [str(number) for number in range(len(contents))]
    return _of_points(paths[0], labels, bodies, names if named and names else None)


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
    contents = read_json(paths[0])
    frames = contents if isinstance(contents, dict) else dict(enumerate(contents))
    names = tuple(dict.fromkeys(name for frame in frames.values() for name in frame))
    bodies: list[tuple[list[dict[str, Any]], int]] = []
    for number, (label, frame) in enumerate(frames.items()):
        with parsing(f"{paths[0]}: {label}", "give [x, y] or [x, y, confidence]"):
            points = [frame.get(name) or {"x": None, "y": None} for name in names]
            for place, point in enumerate(points):
                if isinstance(point, list):
                    require(len(point) in (2, 3), f"a point of {len(point)} numbers")
                    points[place] = dict(zip(("x", "y", "score"), point, strict=False))
                else:
                    require({"x", "y"} <= point.keys(), "no point")
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
    images = number_images(path, video_name(path), labels)
    return as_poses(images, detections, missing="unplaced", unit=None, landmark_names=names)


# What all have in common.

POSE = ("pose_keypoints_2d", "pose_keypoints", "joints", "keypoints")
WHO = ("person_id", "track_id", "idx")


def _first(content: Mapping[str, Any], keys: Iterable[str], default: Any = None) -> Any:
    """Return the value of the first key that an object has."""
    return next((content[key] for key in keys if content.get(key) is not None), default)


def _people_of(contents: Any) -> list[Any] | None:
    """Return the people of a frame; None where the file is not of this kind."""
    if not isinstance(contents, dict):
        return None
    for key in ("people", "bodies"):
        if key in contents and isinstance(people := contents[key] or [], list):
            return people
    return [] if contents.keys() <= {"version", "part_candidates"} else None


def _detections(
    people: Any, image: int, place: str | Path, *, needed: bool = False
) -> list[Detection]:
    """Return the people of an image, who may have no landmarks unless they are `needed`.

    The landmarks of each are x, y, confidence in one list, or [x, y] beside `keypoint_scores`.
    """
    detections = []
    with parsing(place, CHECK):
        require(isinstance(people, list), "no list of people")
        for person in people:
            points = _first(person, POSE)
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
            if len(points) % 3:
                require(False, f"a person of {len(points)} numbers, not 3 a landmark")
            detections.append(Detection(points, image, _first(person, WHO)))
    return detections


def as_poses(
    images: Images,
    detections: Sequence[Detection],
    *,
    missing: str = "unscored",
    scored: bool = True,
    alphapose: bool = False,
    unit: str | None = "px",
    notes: tuple[str, ...] = (),
    frame_count: int | None = None,
    **fields: Any,
) -> Poses:
    """Return detections as poses; without names landmarks are those of the usual skeleton.

    A landmark is missing where it has no confidence (`unscored`), no numbers (`unplaced`), or is
    `at origin` with a confidence of 0; the others say how sure they are where they are `scored`.
    AlphaPose states confidences of 0 to 6, and newer models of it give 0 to 1: where one is above
    2, all are divided by 6. Without a unit the points are fractions where they can be. Raises
    InputError where detections have different numbers of landmarks, and for texts.
    """
    count = len(images.labels) if frame_count is None else frame_count
    sizes = Counter(len(one.numbers) for one in detections if one.numbers)
    if len(sizes) > 1:
        kinds = [f"{n} detections with {s // 3}" for s, n in sorted(sizes.items())]
        fix = "give the files of each skeleton in a separate call"
        raise input_error(images.name, f"several skeletons: {listed(kinds, 'and')} landmarks", fix)
    width = next(iter(sizes), 0)
    if not width:
        notes += (f"nobody was found in {counted(count, 'frame')}",)
        detections, scored, unit, fields = (), False, "px", {}
    nothing = [math.nan] * width
    with parsing(images.name, CHECK):
        values = np.array([one.numbers or nothing for one in detections], np.float64)
        values = values.reshape(len(detections), width // 3, 3)
    values = np.where(np.isfinite(values), values, np.nan)
    points, confidence = values[..., :2], values[..., 2]
    if alphapose and np.nanmax(confidence, initial=0) > 2:
        confidence = confidence / 6
        notes += ("confidences divided by 6, the largest that AlphaPose states",)
    absent = {
        "unscored": ~(confidence > 0),
        "unplaced": np.isnan(points).any(axis=2),
        "at origin": np.isnan(values).any(axis=2)
        | (np.isin(points, (0, -1)).all(axis=2) & (confidence == 0)),
    }[missing]
    if unit is None:
        fractions = are_fractions(points[np.isfinite(values).all(axis=2)])
        unit = FRACTION if fractions else UNKNOWN_UNIT
        fields["size_needed"] = fractions
    frame = np.array([images.frames[one.image] for one in detections], np.int64)
    who = [_identity(one.who) for one in detections]
    times = Counter((one.image, name) for one, name in zip(detections, who, strict=True) if name)
    if doubles := sum(number > 1 for number in times.values()):
        # Some tools number the people of each frame anew.
        notes += (f"numbers of people are not used, as {doubles} of them occur twice in a frame",)
        who = [""] * len(who)
    videos = [images.videos[one.image] for one in detections]
    usual = None if fields.get("landmark_names") else skeletons_of_size(width // 3)
    poses = Poses(
        name=images.name,
        video=videos if len({*images.videos}) != 1 else images.videos[0],
        points=np.where(absent[..., None], np.nan, points),
        confidence=np.where(absent, 0.0, np.nan_to_num(confidence)) if scored else None,
        frame=frame,
        label=[images.labels[one.image] for one in detections],
        individual=who,
        skeleton=usual[0] if usual else None,
        frame_count=count,
        unit=unit,
        unordered=images.unordered,
        notes=notes,
        **fields,
    )
    numbers = {video: number for number, video in enumerate(dict.fromkeys(videos))}
    return poses.take(np.lexsort((frame, np.array([numbers[video] for video in videos]))))


def _identity(who: Any) -> str:
    """Return an identity as text, "" for none: a number, a text, or a list of one of them."""
    while isinstance(who, list) and len(who) == 1:
        who = who[0]
    if isinstance(who, bool) or not isinstance(who, int | float | str):
        return ""
    if isinstance(who, str):
        return who
    return "" if who < 0 or who != who else f"id {who:g}"
