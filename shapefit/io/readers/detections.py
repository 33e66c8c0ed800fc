"""Detections of people and animals: a file for each image of OpenPose, MMPose, Hugging
Face, Ultralytics or YOLO, and files of MMPose for a video.

Files differ in where the people of a frame stand, as a rule without an identity over
frames.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Required

import numpy as np
from typing_extensions import TypedDict

from shapefit.arrays import Floats
from shapefit.errors import input_error, listed
from shapefit.io.formats import FIRST, Head
from shapefit.io.readers.declared import Identity, check_json
from shapefit.io.readers.poses import (
    FRACTION,
    Edges,
    FormatError,
    Images,
    Poses,
    UnitFields,
    as_numbers,
    guess_unit,
    library_reads,
    name_individual,
    parsing,
    require,
    series_numbers,
    skeleton_edges,
    video_name,
)
from shapefit.io.readers.text import parse_floats, read_json, read_text
from shapefit.io.skeletons import skeletons_of_size

Detection = tuple[Floats, int, object]
"""x, y, confidence of all landmarks (p, 3), NaN for none; number of the image; who it
is.
"""

# One file per image.

LISTS = ("pose_keypoints_2d", "pose_keypoints", "keypoints")
"""Where the landmarks of a person stand."""

WHO = ("person_id", "track_id", "idx")
"""Where its identity stands."""

SCORES = ("keypoint_scores", "scores", "keypoints_scores")
"""Where the confidences of landmarks stand that are pairs."""

LEFT_OUT = (
    "face_keypoints_2d",
    "hand_left_keypoints_2d",
    "hand_right_keypoints_2d",
    "pose_keypoints_3d",
)
"""Lists of OpenPose beside those of the body."""


def is_openpose(head: Head) -> bool:
    """Whether a file is OpenPose's JSON: `people` with landmarks, or nobody."""
    if not isinstance(head.json, dict):
        return False
    people = head.json.get("people")
    if people is None:
        return head.json.keys() == {"version"}  # an image without people
    if not isinstance(people, list):
        return False
    return not people or bool(_all_keys(people) & {*LISTS, *LEFT_OUT})


def is_people_of_an_image(head: Head) -> bool:
    """Whether a file is a JSON list of people with keypoints, without image ids.

    It may be empty. Their keypoints are pairs, or lists of x and of y.
    """
    if not isinstance(head.json, list) or "image_id" in head.keys:
        return False
    if not head.json:
        return True
    people = [one for one in head.json[:FIRST] if isinstance(one, dict)]
    keypoints = [one["keypoints"] for one in people if one.get("keypoints")]
    return bool(keypoints) and all(map(_are_keypoints, keypoints))


def _are_keypoints(keypoints: object) -> bool:
    """Whether JSON is a list of [x, y, ...] lists, or an object with "x" and "y"."""
    if isinstance(keypoints, dict):
        return {"x", "y"} <= keypoints.keys()
    return isinstance(keypoints, list) and isinstance(keypoints[0], list)


def _all_keys(people: Sequence[object]) -> set[str]:
    """Return the keys that any of the people has, of those that are objects."""
    return {key for one in people if isinstance(one, dict) for key in one}


def read_image_files(paths: tuple[Path, ...]) -> Poses:
    """Read files of JSON, each with the detected people of one image.

    They are OpenPose's, or lists as MMPose, Hugging Face and Ultralytics write them.

    A landmark of confidence 0 is missing. Pose2Sim, Sports2D and RTMLib write such
    files, too.
    """
    files, images = _find_images(paths, ".json")
    detections: list[Detection] = []
    left_out: Counter[str] = Counter()
    for number, file in enumerate(files):
        with parsing(
            file, "a file of people", "remove it from the folder, or export it again"
        ):
            content = read_json(file)
            if isinstance(content, dict):
                others = content.keys() - {"version"}
                require("people" in content or not others, "there is no list of people")
                content = content.get("people", [])
            people = _check_people(content)
            detections += _detections_of(people, number)
            for person in people:
                left_out.update(one for one in LEFT_OUT if any(person.get(one) or ()))
    names = listed(left_out, "and") if left_out else ""
    note = f"landmarks beside those of the body left out: {names}"
    return poses_from_detections(images, detections, notes=(note,) if left_out else ())


def _check_people(content: object) -> list[dict[str, Any]]:
    """Check that parsed JSON is a list of people (objects), and return it."""
    require(isinstance(content, list), "no list of people")
    return check_json(list[dict[str, Any]], content)


def _detections_of(
    people: Sequence[Mapping[str, object]], image: int, *, needed: bool = False
) -> list[Detection]:
    """Return a detection for each of the people in image number `image`.

    People without landmarks raise FormatError if landmarks are `needed`.
    """
    detections: list[Detection] = []
    for person in people:
        points = person_points(person, needed=needed)
        detections.append((points, image, person_identity(person)))
    return detections


def person_identity(person: Mapping[str, object]) -> object:
    """Return the id or track of a person, None if its file states none."""
    return _first_value(person, WHO)


def person_points(person: Mapping[str, object], *, needed: bool = False) -> Floats:
    """Return x, y, confidence (p, 3) of the landmarks of a person.

    Without any (0, 3), or FormatError where they are `needed`.

    They are three numbers a landmark in one list, [x, y] beside a list of confidences,
    or lists of x and y and, if any, `visible`.
    """
    given = _first_value(person, LISTS)
    if given is None or (given == [] and not needed):
        require(not needed, "a person without a list of keypoints")
        return np.empty((0, 3))
    if isinstance(given, dict):
        return _points_of_lists(given)
    require(isinstance(given, list), "a person without a list of keypoints")
    values = as_numbers(given, "keypoints of a person")
    if values.ndim == 1:
        problem = f"a person of {len(values)} numbers, not 3 a landmark"
        require(len(values) % 3 == 0, problem)
        return values.reshape(-1, 3)
    if values.ndim != 2 or values.shape[1] != 2:
        solid = values.ndim == 2 and values.shape[1] == 3
        what = "[x, y, z], so points in 3D" if solid else "no pairs [x, y]"
        raise FormatError(f"keypoints are {what}", "give landmarks in 2D")
    given_scores = _first_value(person, SCORES)
    if given_scores is None:
        return np.column_stack([values, np.ones(len(values))])
    scores = as_numbers(given_scores, "confidences of a person")
    counts = f"{len(values)} landmarks of a person, and {scores.size} confidences"
    require(scores.shape == values.shape[:1], counts)
    return np.column_stack([values, scores])


def _points_of_lists(given: Mapping[str, object]) -> Floats:
    """Return x, y, confidence (p, 3) from lists `x`, `y` and, if any, `visible`."""
    require({"x", "y"} <= given.keys(), "keypoints without lists of x and y")
    x, y = (as_numbers(given[axis], f"{axis} of keypoints") for axis in ("x", "y"))
    seen = given.get("visible")
    scores = np.ones(x.shape) if seen is None else as_numbers(seen, "visible")
    same = x.ndim == 1 and x.shape == y.shape == scores.shape
    require(same, "lists x, y and visible of different lengths")
    return np.column_stack([x, y, scores])


def _first_value(content: Mapping[str, object], keys: Sequence[str]) -> object:
    """Return the first value that is not None under these keys, None without any."""
    return next((content[key] for key in keys if content.get(key) is not None), None)


BOX = 5
"""Numbers of YOLO before the landmarks: a class, and the centre and size of a box."""

DATA = "data.yaml"
"""The file that names the landmarks of YOLO."""


def is_yolo(head: Head) -> bool:
    """Whether a .txt file begins with a line of YOLO: a class, a box and landmarks.

    Box and landmarks are fractions of the image.
    """
    lines = (line.strip() for line in head.lines)
    first = next((line for line in lines if line and not line.startswith(b"#")), b"")
    try:
        kind, *numbers = map(float, first.split() if head.has_suffix(".txt") else ())
    except ValueError:
        return False
    box, point = numbers[:4], numbers[4:6]
    placed = len(point) == 2 and all(-1 <= value <= 2 for value in point)
    inside = all(0 <= value <= 1 for value in box)
    return kind.is_integer() and kind >= 0 and placed and inside


class _DataYaml(TypedDict, total=False):
    kpt_shape: list[int] | None
    kpt_names: object
    names: object
    skeleton: object


def read_yolo(paths: tuple[Path, ...]) -> Poses:
    """Read files of YOLO's labels: a line for each detection, in fractions of an image.

    A line is class, centre and size of a box, and x, y and v of each landmark;
    predictions may end in a score and a track. v is 0 (missing), 1, 2, or a confidence.
    `kpt_shape` in data.yaml beside the labels says whether it is left out: then a
    landmark at 0, 0 is missing.
    """
    files, images = _find_images(paths, ".txt")
    data = _read_data_yaml(paths[0] if paths[0].is_dir() else paths[0].parent)
    rows = _read_labels(files)
    with parsing(paths[0], "labels of YOLO", f"correct {DATA}"):
        count, step = _shape_of_labels(data, rows)
    detections: list[Detection] = []
    for number, row in rows:
        with parsing(files[number], "labels of YOLO", f"check kpt_shape in {DATA}"):
            points, who = _parse_label(row, count, step, alone=not data)
        detections.append((points, number, who))
    marks = [points[:, 2] for points, *_ in detections]
    return poses_from_detections(
        images,
        detections,
        scored=any(not np.isin(values, (0, 1, 2)).all() for values in marks),
        unit=FRACTION,
        landmark_names=_names_of_data(data, count),
        edges=skeleton_edges(data.get("skeleton"), count),
    )


def _read_data_yaml(folder: Path) -> _DataYaml:
    """Read data.yaml in a folder, or in the nearest of three above it; {} without one.

    Raises InputError for what is no YAML, or has other values.
    """
    from ruamel.yaml import YAML

    folder = folder.resolve()
    paths = (place / DATA for place in (folder, *folder.parents[:3]))
    path = next((path for path in paths if path.is_file()), None)
    if path is None:
        return {}
    with parsing(path, "YAML", "correct it"):
        with library_reads("it is no YAML"):
            content = YAML(typ="safe", pure=True).load(path)
        return check_json(_DataYaml, content if isinstance(content, dict) else {})


Label = tuple[int, list[float]]
"""The number of a file, and the numbers of a line in it."""


def _read_labels(files: Sequence[Path]) -> list[Label]:
    """Read label files; return the file's index and the numbers of each line.

    Raises InputError, naming the line, for what is no number.
    """
    rows: list[Label] = []
    for number, file in enumerate(files):
        for line, text in enumerate(read_text(file).split("\n"), 1):
            with parsing(f"{file}:{line}", "a label of YOLO"):
                cells = text.partition("#")[0].split()
                if cells:
                    rows.append((number, parse_floats(cells)))
    return rows


def _shape_of_labels(data: _DataYaml, rows: Sequence[Label]) -> tuple[int, int]:
    """Return how many landmarks a line has, and how many values each landmark has.

    As data.yaml says, else as many landmarks of three as the shortest line holds.
    Raises FormatError for another `kpt_shape`.
    """
    shortest = min((len(row) for _, row in rows), default=BOX) - BOX
    shape = data.get("kpt_shape") or [shortest // 3, 3]
    whole = len(shape) == 2 and shape[0] >= 0
    require(whole, f"kpt_shape {shape} in {DATA} is not [landmarks, 2 or 3]")
    count, step = shape
    return count, step


def _parse_label(
    row: Sequence[float], count: int, step: int, *, alone: bool
) -> tuple[Floats, float | None]:
    """Return x, y, v (p, 3) of the landmarks of a line, and its track id or None.

    The line begins with its class and box; each of `count` landmarks has `step`
    numbers, 2 or 3. Where no data.yaml stands beside the lines (`alone`), v must be 0,
    1 or 2 for a line to be of landmarks, unless there are as many as people have.
    Raises FormatError for other lines.
    """
    width = BOX + count * step
    given = f"a line of {len(row)} numbers, and {count} landmarks take {width}"
    require(step in (2, 3) and len(row) - width in (0, 1, 2), given)
    marked = count == 17 or {*row[BOX + 2 : width : 3]} <= {0, 1, 2}
    require(not alone or marked, f"no {DATA} beside them, and v is not 0, 1 or 2")
    points = np.reshape(row[BOX:width], (count, step))
    if step == 2:
        points = np.column_stack([points, (points > 0).any(axis=1)])
    return points, row[-1] if len(row) == width + 2 else None


def _names_of_data(data: _DataYaml, count: int) -> tuple[str, ...] | None:
    """Return the names of `count` landmarks by data.yaml, else numbers as names.

    None for people, whose names are known, and for no landmarks.
    """
    names = data.get("kpt_names")
    if isinstance(names, dict):  # a list for each class, of which the first is taken
        names = next(iter(names.values()), None)
    if isinstance(names, list) and len(names) == count:
        return tuple(map(str, names)) or None
    people = not data or data.get("names") in (["person"], {0: "person"})
    if people and count == 17:
        return None
    return tuple(map(str, range(count))) or None


def _find_images(paths: Sequence[Path], suffix: str) -> tuple[Sequence[Path], Images]:
    """Sort files, or those of a folder, by frame number; return them and their Images.

    Each file is of one image.

    Where names differ in one number alone it is that of the frame; else each is that of
    an image. Raises InputError for links that lead nowhere, pipes and devices, which
    cannot be read whole.
    """
    folder, files = paths[0].parent, sorted(paths)
    if paths[0].is_dir():
        folder = paths[0]
        inner = (path for path in sorted(folder.iterdir()) if not path.is_dir())
        files = [path for path in inner if path.name.lower().endswith(suffix)]
    for file in files:
        if not file.is_file():
            fix = "remove it, or name the files themselves"
            raise input_error(file, "is not a regular file", fix)
    name = str(paths[0] if len(files) == 1 else folder)
    video = [folder.resolve().name] * len(files)
    labels = [file.stem for file in files]
    numbers = series_numbers(labels)
    if numbers is None:
        images = Images(name, video, range(len(files)), labels, unordered=True)
        return files, images
    order = sorted(range(len(files)), key=numbers.__getitem__)
    ordered = [numbers[row] for row in order]
    frames = [number - ordered[0] for number in ordered]
    images = Images(name, video, frames, [*map(str, ordered)])
    return [files[row] for row in order], images


# One file of all images.


class _Frame(TypedDict, total=False):
    frame_id: Identity | None
    instances: Required[list[object]]


class _Meta(TypedDict, total=False):
    keypoint_id2name: dict[str, str] | None
    skeleton_links: object


class _TrackedVideo(TypedDict, total=False):
    meta_info: _Meta | None
    instance_info: Required[list[dict[str, object]]]


def is_mmpose_video(head: Head) -> bool:
    """Whether a file is MMPose's JSON of instances in frames, or in one image."""
    if isinstance(head.json, dict):
        return "instance_info" in head.keys
    return isinstance(head.json, list) and "instances" in head.keys


def read_mmpose_video(paths: tuple[Path, ...]) -> Poses:
    """Read MMPose's JSON of a video: a list of {frame_id, instances}.

    It may stand as `instance_info` beside `meta_info`.

    An instance has keypoints [[x, y], ...] and keypoint_scores; `meta_info` the names,
    by number.
    """
    content = read_json(paths[0])
    meta: _Meta = {}
    if isinstance(content, dict):
        video = check_json(_TrackedVideo, content)
        meta, content = video.get("meta_info") or {}, video["instance_info"]
        if content and "instances" not in content[0]:  # of one image
            content = [{"frame_id": 0, "instances": content}]
    frames = check_json(list[_Frame], content)
    numbers, labels = _number_frames([frame.get("frame_id") for frame in frames])
    detections: list[Detection] = []
    for number, frame in enumerate(frames):
        people = _check_people(frame["instances"])
        detections += _detections_of(people, number, needed=True)
    names = meta.get("keypoint_id2name") or {}
    whole = {*names} == {*map(str, range(len(names)))}
    require(whole, "keypoint_id2name does not number the landmarks from 0 on")
    video_of = [video_name(paths[0])] * len(frames)
    return poses_from_detections(
        Images(str(paths[0]), video_of, numbers, labels),
        detections,
        landmark_names=tuple(names[str(number)] for number in range(len(names)))
        or None,
        edges=skeleton_edges(meta.get("skeleton_links"), len(names)),
    )


def _number_frames(stated: Sequence[Identity | None]) -> tuple[list[int], list[str]]:
    """Convert stated frame ids to frames, 0 for the least, and labels of frames.

    They are in the order of the file where not all have a number.

    Raises FormatError for a frame that is there twice.
    """
    labels = [str(i) if one is None else str(one) for i, one in enumerate(stated)]
    twice = next((name for name, n in Counter(labels).items() if n > 1), None)
    require(twice is None, f"frame {twice} twice")
    numbers = [one for one in stated if isinstance(one, int)]
    if len(numbers) < len(stated):
        return [*range(len(stated))], labels
    return [number - min(numbers) for number in numbers], labels


# What all have in common.


def poses_from_detections(
    images: Images,
    detections: Sequence[Detection],
    *,
    hide_unscored: bool = True,
    scored: bool = True,
    unit: str | None = "px",
    landmark_names: tuple[str, ...] | None = None,
    edges: Edges = (),
    notes: tuple[str, ...] = (),
) -> Poses:
    """Make Poses of detections in images, in the order of videos and frames.

    A landmark is missing where it has no number, and to `hide_unscored`, where its
    confidence is not above 0. Confidences of AlphaPose run to 6, or to 1 with newer
    models: where one is above 2, all are divided by 6. Without a unit the points are
    fractions where they can be. Raises InputError where detections have different
    numbers of landmarks.
    """
    detections = _order_detections(images, detections)
    values = _stack_points(images, detections, len(landmark_names or ()))
    confidence = values[..., 2]
    if scored and np.nanmax(confidence, initial=0) > 2:
        confidence = confidence / 6
        notes += ("confidences divided by 6, the largest that AlphaPose states",)
    missing = ~np.isfinite(values).all(axis=2) | (hide_unscored & ~(confidence > 0))
    points = np.where(missing[..., None], np.nan, values[..., :2])
    individuals, doubled = _name_people(detections)
    image_of = [image for _, image, _ in detections]
    in_unit: UnitFields = {"unit": unit or "", "size_needed": False}
    stated = guess_unit(points) if unit is None else in_unit
    return Poses(
        name=images.name,
        video=[images.videos[image] for image in image_of],
        points=points,
        confidence=np.where(missing, 0.0, confidence) if scored else None,
        frame=np.array([images.frames[image] for image in image_of], np.int64),
        label=[images.labels[image] for image in image_of],
        individual=individuals,
        skeleton=next(iter(skeletons_of_size(values.shape[1])), None),
        unordered=images.unordered,
        notes=notes + doubled,
        landmark_names=landmark_names,
        edges=edges,
        **stated,
    )


def _order_detections(
    images: Images, detections: Sequence[Detection]
) -> list[Detection]:
    """Sort detections by video and frame of their images."""
    place = {video: number for number, video in enumerate(dict.fromkeys(images.videos))}
    order = [(place[images.videos[i]], images.frames[i]) for _, i, _ in detections]
    ranked = sorted(range(len(detections)), key=order.__getitem__)
    return [detections[row] for row in ranked]


def _stack_points(
    images: Images, detections: Sequence[Detection], expected: int
) -> Floats:
    """Stack x, y, confidence of detections (N, p, 3), NaN for those without landmarks.

    p is `expected` where none has landmarks. Raises InputError where detections have
    different numbers of landmarks.
    """
    sizes = Counter(len(points) for points, *_ in detections if len(points))
    if len(sizes) > 1:
        kinds = [f"{n} detections with {p}" for p, n in sorted(sizes.items())]
        problem = f"several skeletons: {listed(kinds, 'and')} landmarks"
        fix = "give the files of each in a separate call"
        raise input_error(images.name, problem, fix)
    values = np.full((len(detections), next(iter(sizes), expected), 3), np.nan)
    for row, (points, *_) in enumerate(detections):
        if len(points):
            values[row] = points
    return values


def _name_people(detections: Sequence[Detection]) -> tuple[list[str], tuple[str, ...]]:
    """Return the individual's name of each detection, and notes.

    Where some are twice in a frame all are "", with a note: some tools number the
    people of each frame anew.
    """
    individuals = [name_individual(who) for *_, who in detections]
    image_of = [image for _, image, _ in detections]
    times = Counter(zip(image_of, individuals, strict=True))
    doubles = sum(number > 1 for (_, name), number in times.items() if name)
    if not doubles:
        return individuals, ()
    note = (
        f"numbers of people are not used, as {doubles} of them occur twice in a frame"
    )
    return [""] * len(individuals), (note,)
