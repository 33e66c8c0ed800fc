"""Detections of people and animals: OpenPose, AlphaPose, COCO, MMPose, MediaPipe, YOLO.

Their tools write x, y and a confidence of each landmark, the people of a frame in any order, as a
rule without an identity over frames. They differ in where the people of a frame stand.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from shapefit.errors import input_error, listed
from shapefit.io.readers.poses import (
    FRACTION,
    LAST_NUMBER,
    Poses,
    are_series,
    check_names,
    edges_of,
    image_labels,
    name_individual,
    parsing,
    require,
    unit_of,
    video_name,
)
from shapefit.io.readers.text import floats, read_json, read_text
from shapefit.io.skeletons import skeletons_of_size

Detection = tuple[Sequence[Any], int, Any]
"""x, y and confidence of each landmark, [] where nothing was seen; the image; who it is."""


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
    detections: list[Detection] = []
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
        detections.append((points.ravel().tolist(), number, who))
    names = data.get("kpt_names")
    if isinstance(names, dict):  # a list for each class, of which the first is taken
        names = next(iter(names.values()), None)
    people = not data or data.get("names") in (["person"], {0: "person"})
    if not isinstance(names, list) or len(names) != count:
        names = () if people and count == 17 else range(count)
    return _as_poses(
        images,
        detections,
        scored=any({*numbers[2::3]} - {0, 1, 2} for numbers, *_ in detections),
        unit=FRACTION,
        landmark_names=tuple(map(str, names)) or None,
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
    folder, files = paths[0].parent, sorted(paths)
    if paths[0].is_dir():
        folder = paths[0]
        inner = (path for path in sorted(folder.iterdir()) if not path.is_dir())
        files = [path for path in inner if path.name.lower().endswith(suffix)]
    for file in files:
        if not file.is_file():
            fix = "remove it, or name the files themselves"
            raise input_error(file, "is not a regular file", fix)
    name, video = str(paths[0] if len(files) == 1 else folder), folder.resolve().name
    labels = [file.stem for file in files]
    if not are_series(labels):
        return files, Images(name, video, labels, range(len(files)), unordered=True)
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
    detections: list[Detection] = []
    for entry in content.get("annotations", ()):
        if keypoints := entry.get("keypoints"):
            image = order.setdefault(entry["image_id"], len(order))
            if place:  # those of the category among those of all
                here, points = columns[entry.get("category_id")], np.zeros((len(place), 3))
                points[here] = np.reshape(keypoints, (len(here), 3))
                keypoints = points.ravel().tolist()
            detections.append((keypoints, image, entry.get("track_id")))
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
    may be a little above 1. `meta_info` has the names, by number.
    """
    content = read_json(paths[0])
    meta: Any = {}
    if isinstance(content, dict):
        meta, content = content.get("meta_info") or {}, content["instance_info"]
    if content and "instances" not in content[0]:
        content = [{"frame_id": 0, "instances": content}]
    detections: list[Detection] = []
    for number, frame in enumerate(content):
        detections += _detections(frame["instances"], number, needed=True)
    names = meta.get("keypoint_id2name") or {}
    labels = [str(frame.get("frame_id", number)) for number, frame in enumerate(content)]
    return _as_poses(
        _of_video(paths[0], labels),
        detections,
        landmark_names=tuple(names[str(number)] for number in range(len(names))) or None,
        edges=edges_of(meta.get("skeleton_links"), len(names)),
    )


BODIES = ("pose_landmarks", "poseLandmarks", "landmarks", "landmark", "keypoints", "hand_landmarks")
"""Keys of bodies, the first that an object has; landmarks in metres (`world`) are not read."""

SCORES = ("visibility", "score", "confidence", "presence")


def read_mediapipe(paths: tuple[Path, ...]) -> Poses:
    """Read landmarks as MediaPipe gives them: lists of {x, y, z, visibility}.

    Each body is such a list. A frame has one, or a list of them, or an object with them under
    `pose_landmarks` or the like. A file has one frame, a list of them, or an object with `frames`.
    x and y are fractions of the image; a point without a confidence has that of 1.
    """
    content = read_json(paths[0])
    if isinstance(content, dict):
        content = content.get("frames") or content.get("results") or [content]
    elif _is_body(content):
        content = [content]
    bodies = [(body, number) for number, frame in enumerate(content) for body in _bodies(frame)]
    require(bodies, "no list of landmarks")
    names = tuple(str(point.get("name") or "") for point in bodies[0][0])
    detections = []
    for body, number in bodies:
        rows = ((point.get("x"), point.get("y"), _first(point, SCORES, 1.0)) for point in body)
        detections.append(([value for row in rows for value in row], number, None))
    images = _of_video(paths[0], [*map(str, range(len(content)))])
    return _as_poses(
        images,
        detections,
        hide_unscored=False,
        unit=None,
        landmark_names=names if all(names) else None,
    )


def _is_body(content: Any) -> bool:
    return isinstance(content, list) and any(isinstance(p, dict) and "x" in p for p in content)


def _bodies(frame: Any) -> Iterator[list[dict[str, Any]]]:
    """Yield the bodies of a frame; there may be none."""
    if isinstance(frame, dict):
        frame = _first(frame, BODIES, ())
    if _is_body(frame):
        yield [point if isinstance(point, dict) else {} for point in frame]
    elif isinstance(frame, list):
        for one in frame:
            yield from _bodies(one)


def read_named_points(paths: tuple[Path, ...]) -> Poses:
    """Read {frame: {landmark: [x, y] or [x, y, confidence]}}, one body per frame.

    A landmark that a frame lacks is missing.
    """
    frames = read_json(paths[0])
    names = tuple(dict.fromkeys(name for frame in frames.values() for name in frame))
    detections: list[Detection] = []
    for number, frame in enumerate(frames.values()):
        points = [frame.get(name) or [None, None] for name in names]
        sizes = {2, *map(len, points)}
        require(sizes <= {2, 3}, f"a point of {max(sizes)} numbers")
        numbers = [value for point in points for value in [*point, 1.0][:3]]
        detections.append((numbers, number, None))
    images = _of_video(paths[0], [*frames])
    return _as_poses(images, detections, hide_unscored=False, unit=None, landmark_names=names)


# What all have in common.


def _name_images(path: Path, names: Sequence[Any]) -> Images:
    """Return the images of a file, called without folder and ending where that tells them apart."""
    labels = image_labels([*map(str, names)])
    return _of_video(path, labels)._replace(unordered=not are_series(labels))


def _of_video(path: Path, labels: Sequence[str]) -> Images:
    return Images(str(path), video_name(path), labels, range(len(labels)))


POSE = ("pose_keypoints_2d", "pose_keypoints", "joints", "keypoints")
WHO = ("person_id", "track_id", "idx")


def _first(content: Mapping[str, Any], keys: Sequence[str], default: Any = None) -> Any:
    """Return the value of the first key that an object has."""
    return next((content[key] for key in keys if content.get(key) is not None), default)


def _people_of(frame: Mapping[str, Any]) -> Any:
    """Return the people of a frame; None where it is not of this kind."""
    return _first(frame, ("people", "bodies"), [] if [*frame] == ["version"] else None)


def _detections(people: Any, image: int, *, needed: bool = False) -> list[Detection]:
    """Return the people of an image, who may have no landmarks unless they are `needed`.

    The landmarks of each are x, y, confidence in one list, or [x, y] beside `keypoint_scores`.
    """
    detections: list[Detection] = []
    require(isinstance(people, list), "no list of people")
    for person in people:
        numbers = _first(person, POSE, None if needed else [])
        require(numbers is not None, "a person without keypoints")
        require(isinstance(numbers, list), "keypoints that are no list")
        if numbers and isinstance(numbers[0], list):
            scores = _first(person, ("keypoint_scores",), [1.0] * len(numbers))
            scored = zip(numbers, scores, strict=True)
            numbers = [number for (x, y), score in scored for number in (x, y, score)]
        require(len(numbers) % 3 == 0, f"a person of {len(numbers)} numbers, not 3 a landmark")
        detections.append((numbers, image, _first(person, WHO)))
    return detections


def _as_poses(
    images: Images,
    detections: Sequence[Detection],
    *,
    hide_unscored: bool = True,
    scored: bool = True,
    alphapose: bool = False,
    unit: str | None = "px",
    landmark_names: tuple[str, ...] | None = None,
    edges: tuple[tuple[int, int], ...] = (),
) -> Poses:
    """Return detections as poses; without names landmarks are those of the usual skeleton.

    A landmark is missing where it has no number, and to `hide_unscored`, where its confidence is
    not above 0; the others say how sure they are where they are `scored`. AlphaPose states
    confidences of 0 to 6, and newer models of it give 0 to 1: where one is above 2, all are divided
    by 6. Without a unit the points are fractions where they can be. Raises InputError where
    detections have different numbers of landmarks.
    """
    detections = sorted(detections, key=lambda one: one[1])
    sizes = Counter(len(numbers) // 3 for numbers, *_ in detections if numbers)
    if len(sizes) > 1:
        kinds = [f"{n} detections with {p}" for p, n in sorted(sizes.items())]
        fix = "give the files of each skeleton in a separate call"
        raise input_error(images.name, f"several skeletons: {listed(kinds, 'and')} landmarks", fix)
    p, notes = next(iter(sizes), len(landmark_names or ())), list[str]()
    rows = [numbers or [None] * (3 * p) for numbers, *_ in detections]
    values = np.array(rows, np.float64).reshape(len(rows), p, 3)
    points, confidence = values[..., :2], values[..., 2]
    if alphapose and np.nanmax(confidence, initial=0) > 2:
        confidence = confidence / 6
        notes.append("confidences divided by 6, the largest that AlphaPose states")
    missing = ~np.isfinite(values).all(axis=2) | (hide_unscored & ~(confidence > 0))
    points = np.where(missing[..., None], np.nan, points)
    who = [name_individual(one) for *_, one in detections]
    times = Counter((image, name) for (_, image, _), name in zip(detections, who, strict=True))
    if doubles := sum(number > 1 for (_, name), number in times.items() if name):
        # Some tools number the people of each frame anew.
        notes.append(f"numbers of people are not used, as {doubles} of them occur twice in a frame")
        who = [""] * len(who)
    usual = [*skeletons_of_size(p)[:1], None][0]
    return Poses(
        name=images.name,
        video=images.video,
        points=points,
        confidence=np.where(missing, 0.0, confidence) if scored else None,
        frame=np.array([images.frames[image] for _, image, _ in detections], np.int64),
        label=[images.labels[image] for _, image, _ in detections],
        individual=who,
        landmark_names=landmark_names,
        skeleton=None if landmark_names else usual,
        frame_count=len(images.labels),
        unordered=images.unordered,
        edges=edges,
        notes=tuple(notes),
        **(unit_of(points) if unit is None else {"unit": unit}),
    )
