"""Detections of people and animals: OpenPose, COCO (and AlphaPose), MMPose, MediaPipe,
YOLO.

Files differ in where the people of a frame stand, as a rule without an identity over
frames.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

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

Detection = tuple[
    Sequence[Any], int, Any
]  # x, y, confidence of all landmarks; image; who it is


# One file per image.


def read_image_files(paths: tuple[Path, ...]) -> Poses:
    """Read a file per frame, with the people in it: OpenPose's, or MMPose's list of
    instances.

    A landmark of confidence 0 is missing. Pose2Sim, Sports2D and RTMLib write such
    files, too.
    """
    files, labels, fields = _find_images(paths, ".json")
    detections: list[Detection] = []
    for number, file in enumerate(files):
        with parsing(
            file, "a file of people", "remove it from the folder, or export it again"
        ):
            content = read_json(file)
            if isinstance(content, dict):
                content = content.get(
                    "people", None if content.keys() - {"version"} else []
                )
            detections += _detections(content, number)
    return _as_poses(paths[0], labels, detections, **fields)


BOX, DATA = (
    5,
    "data.yaml",
)  # numbers of YOLO before landmarks, and the file that names those


def read_yolo(paths: tuple[Path, ...]) -> Poses:
    """Read YOLO's labels: a line for each detection, in fractions of the image.

    A line is class, centre and size of a box, and x, y and v of each landmark;
    predictions may end in a score and a track. v is 0 (missing), 1, 2, or a confidence.
    `kpt_shape` in data.yaml beside the labels says whether it is left out: then a
    landmark at 0, 0 is missing.
    """
    files, labels, fields = _find_images(paths, ".txt")
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
        paths[0],
        labels,
        detections,
        scored=any({*numbers[2::3]} - {0, 1, 2} for numbers, *_ in detections),
        unit=FRACTION,
        landmark_names=tuple(map(str, names)) or None,
        edges=edges_of(data.get("skeleton"), count),
        **fields,
    )


def _read_data_yaml(folder: Path) -> dict[str, Any]:
    """Return the nearest data.yaml in this folder or three above it, {} without; or
    InputError.
    """
    from ruamel.yaml import YAML

    folder = folder.resolve()
    paths = (place / DATA for place in (folder, *folder.parents[:3]))
    path = next((path for path in paths if path.is_file()), None)
    with parsing(path or folder, "YAML", "correct it"):
        content = YAML(typ="safe", pure=True).load(path) if path else {}
    return content if isinstance(content, dict) else {}


def _find_images(
    paths: Sequence[Path], suffix: str
) -> tuple[Sequence[Path], Sequence[str], dict[str, Any]]:
    """Return the files of a folder, or these, in order; their labels, and fields of
    Poses.

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
    fields: dict[str, Any] = {"video": folder.resolve().name}
    fields["name"] = str(paths[0] if len(files) == 1 else folder)
    if not are_series([file.stem for file in files]):
        return files, [file.stem for file in files], fields | {"unordered": True}
    numbered = {int(LAST_NUMBER.findall(file.stem)[0][1]): file for file in files}
    numbers = sorted(numbered)
    fields["places"] = [number - numbers[0] for number in numbers]
    return [numbered[number] for number in numbers], [*map(str, numbers)], fields


# One file of all images.


def read_coco_results(paths: tuple[Path, ...]) -> Poses:
    """Read a list of {image_id, category_id, keypoints, score}, as MMDet and AlphaPose
    write it.

    A landmark of 0, 0, 0 is missing, others of confidence 0 have no weight.
    """
    detections: list[Detection] = []
    numbers: dict[Any, int] = {}
    for entry in read_json(paths[0]):
        image = numbers.setdefault(entry["image_id"], len(numbers))
        detections += _detections([entry], image, needed=True)
    labels = image_labels([*map(str, numbers)])
    unordered = not are_series(labels)
    return _as_poses(
        paths[0], labels, detections, hide_unscored=False, unordered=unordered
    )


def read_coco_annotations(paths: tuple[Path, ...]) -> Poses:
    """Read what people annotated: images, annotations, and categories with names.

    keypoints are [x, y, v, ...]; v = 0 is missing, 1 hidden and 2 visible. Categories
    may have different landmarks: then all names together, in their order.
    """
    content = read_json(paths[0])
    place: dict[str, int] = {}
    columns: dict[Any, list[int]] = {}
    edges: dict[tuple[int, int], None] = {}
    for category in content.get("categories", ()):
        names = category.get("keypoints") or []
        check_names(names, "landmark")
        columns[category["id"]] = here = [
            place.setdefault(name, len(place)) for name in names
        ]
        pairs = edges_of(category.get("skeleton"), len(names) + 1)  # counted from 1
        edges |= {(here[a - 1], here[b - 1]): None for a, b in pairs if a and b}
    images = content.get("images", ())
    names_of = {image["id"]: image.get("file_name") or image["id"] for image in images}
    order = {image: number for number, image in enumerate(names_of)}
    detections: list[Detection] = []
    for entry in content.get("annotations", ()):
        if keypoints := entry.get("keypoints"):
            image = order.setdefault(entry["image_id"], len(order))
            if place:  # those of the category among those of all
                here, points = (
                    columns[entry.get("category_id")],
                    np.zeros((len(place), 3)),
                )
                points[here] = np.reshape(keypoints, (len(here), 3))
                keypoints = points.ravel().tolist()
            detections.append((keypoints, image, entry.get("track_id")))
    labels = image_labels([str(names_of.get(image, image)) for image in order])
    return _as_poses(
        paths[0],
        labels,
        detections,
        scored=False,
        unordered=not are_series(labels),
        landmark_names=tuple(place) or None,
        edges=tuple(edges),
    )


def read_mmpose_video(paths: tuple[Path, ...]) -> Poses:
    """Read a list of {frame_id, instances}, which may stand as `instance_info` beside
    `meta_info`.

    An instance has keypoints [[x, y], ...] and keypoint_scores; `meta_info` the names,
    by number.
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
    labels = [
        str(frame.get("frame_id", number)) for number, frame in enumerate(content)
    ]
    return _as_poses(
        paths[0],
        labels,
        detections,
        landmark_names=tuple(names[str(number)] for number in range(len(names)))
        or None,
        edges=edges_of(meta.get("skeleton_links"), len(names)),
    )


BODIES = (
    "pose_landmarks",
    "poseLandmarks",
    "landmarks",
    "landmark",
    "keypoints",
    "hand_landmarks",
)
SCORES = ("visibility", "score", "confidence", "presence")


def read_mediapipe(paths: tuple[Path, ...]) -> Poses:
    """Read landmarks as MediaPipe gives them: lists of {x, y, z, visibility}.

    Each body is such a list. A frame has one, or a list of them, or an object with them
    under `pose_landmarks` or the like. A file has one frame, a list of them, or an
    object with `frames`.
    """
    content = read_json(paths[0])
    if isinstance(content, dict):
        content = content.get("frames", [content])
    elif _is_body(content):
        content = [content]
    bodies = [
        (body, number)
        for number, frame in enumerate(content)
        for body in _bodies(frame)
    ]
    require(bodies, "no list of landmarks")
    names = tuple(str(point.get("name") or "") for point in bodies[0][0])
    detections = []
    for body, number in bodies:
        rows = (
            (point.get("x"), point.get("y"), _first(point, SCORES, 1.0))
            for point in body
        )
        detections.append(([value for row in rows for value in row], number, None))
    return _as_poses(
        paths[0],
        [*map(str, range(len(content)))],
        detections,
        hide_unscored=False,
        unit=None,
        landmark_names=names if all(names) else None,
    )


def _is_body(content: Any) -> bool:
    return isinstance(content, list) and any(
        isinstance(p, dict) and "x" in p for p in content
    )


def _bodies(frame: Any) -> Iterator[list[dict[str, Any]]]:
    """Yield the bodies of a frame; there may be none."""
    if isinstance(frame, dict):
        frame = _first(frame, BODIES, ())
    if _is_body(frame):
        yield [point if isinstance(point, dict) else {} for point in frame]
    elif isinstance(frame, list):
        for one in frame:
            yield from _bodies(one)


# What all have in common.


POSE = ("pose_keypoints_2d", "pose_keypoints", "keypoints")
WHO = ("person_id", "track_id", "idx")


def _first(content: Mapping[str, Any], keys: Sequence[str], default: Any = None) -> Any:
    """Return the value of the first key that an object has."""
    return next((content[key] for key in keys if content.get(key) is not None), default)


def _detections(people: Any, image: int, *, needed: bool = False) -> list[Detection]:
    """Return the people of an image, who may have no landmarks unless they are
    `needed`.

    The landmarks of each are x, y, confidence in one list, or [x, y] beside
    `keypoint_scores`.
    """
    detections: list[Detection] = []
    require(isinstance(people, list), "no list of people")
    for person in people:
        numbers = _first(person, POSE, None if needed else [])
        require(isinstance(numbers, list), "a person without a list of keypoints")
        if numbers and isinstance(numbers[0], list):
            scores = _first(person, ("keypoint_scores",), [1.0] * len(numbers))
            scored = zip(numbers, scores, strict=True)
            numbers = [number for (x, y), score in scored for number in (x, y, score)]
        require(
            len(numbers) % 3 == 0,
            f"a person of {len(numbers)} numbers, not 3 a landmark",
        )
        detections.append((numbers, image, _first(person, WHO)))
    return detections


def _as_poses(
    path: Path,
    labels: Sequence[str],
    detections: Sequence[Detection],
    *,
    places: Sequence[int] | None = None,
    hide_unscored: bool = True,
    scored: bool = True,
    unit: str | None = "px",
    **fields: Any,
) -> Poses:
    """Return detections in images of these labels (n), at `places` (n) in their video,
    as poses.

    A landmark is missing where it has no number, and to `hide_unscored`, where its
    confidence is not above 0. Confidences of AlphaPose run to 6, or to 1 with newer
    models: where one is above 2, all are divided by 6. Without a unit the points are
    fractions where they can be. Raises InputError where detections have different
    numbers of landmarks.
    """
    fields = {"name": str(path), "video": video_name(path), **fields}
    detections = sorted(detections, key=lambda one: one[1])
    sizes = Counter(len(numbers) // 3 for numbers, *_ in detections if numbers)
    if len(sizes) > 1:
        kinds = [f"{n} detections with {p}" for p, n in sorted(sizes.items())]
        problem = f"several skeletons: {listed(kinds, 'and')} landmarks"
        raise input_error(
            fields["name"], problem, "give the files of each in a separate call"
        )
    p, notes = next(iter(sizes), len(fields.get("landmark_names") or ())), list[str]()
    rows = [numbers or [None] * (3 * p) for numbers, *_ in detections]
    values = np.array(rows, np.float64).reshape(len(rows), p, 3)
    points, confidence = values[..., :2], values[..., 2]
    if scored and np.nanmax(confidence, initial=0) > 2:
        confidence = confidence / 6
        notes.append("confidences divided by 6, the largest that AlphaPose states")
    missing = ~np.isfinite(values).all(axis=2) | (hide_unscored & ~(confidence > 0))
    points = np.where(missing[..., None], np.nan, points)
    images = [image for _, image, _ in detections]
    who = [name_individual(w) for *_, w in detections]
    times = Counter(zip(images, who, strict=True))
    if doubles := sum(number > 1 for (_, name), number in times.items() if name):
        # Some tools number the people of each frame anew.
        notes.append(
            f"numbers of people are not used, as {doubles} of them occur twice in a"
            " frame"
        )
        who = [""] * len(who)
    return Poses(
        points=points,
        confidence=np.where(missing, 0.0, confidence) if scored else None,
        frame=np.array(
            [places[image] for image in images] if places else images, np.int64
        ),
        label=[labels[image] for image in images],
        individual=who,
        skeleton=next(iter(skeletons_of_size(p)), None),
        notes=tuple(notes),
        **(unit_of(points) if unit is None else {"unit": unit}),
        **fields,
    )
