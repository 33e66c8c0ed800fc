"""Detections of people and animals: OpenPose, AlphaPose, COCO, MMPose, MediaPipe, YOLO.

Their tools write x, y and a confidence of each landmark, the people of a frame in any order, as a
rule without an identity over frames. They differ in where the people of a frame stand.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from shapefit.errors import abbreviate, counted, input_error, listed
from shapefit.io.inputs import read_whole
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
from shapefit.io.readers.text import decode, read_json
from shapefit.io.skeletons import skeletons_of_size
from shapefit.io.tidy_table import read_numbers

CHECK = "check what wrote the file"


class Detection(NamedTuple):
    """x, y and confidence of each landmark, none where nothing was found; the image; who it is."""

    numbers: Sequence[float]
    image: int
    who: Any = None


class Images(NamedTuple):
    """The images of a recording, in order: their labels, videos, and positions in these (n).

    name is for messages; `unordered` images are, as far as names say, no frames of a video.
    """

    name: str
    labels: Sequence[str]
    videos: Sequence[str]
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
    without_people: list[str] = []
    further = 0
    for number, file in enumerate(files):
        contents = read_json(file)
        people = contents if isinstance(contents, list) else _people_of(contents)
        if people is None:
            without_people.append(file.name)
        else:
            detections += _detections(people, number, file, needed=people is contents)
            hands = ("face_keypoints_2d", "hand_left_keypoints_2d", "hand_right_keypoints_2d")
            further += sum(any(person.get(key) for key in hands) for person in people)
    texts = {
        f"{counted(len(without_people), 'file')} without people left out "
        f"({abbreviate(without_people)})": without_people,
        f"hands and faces left out, of {counted(further, 'detection')}": further,
    }
    notes = tuple(text for text, some in texts.items() if some)
    return _as_poses(images, detections, notes=notes, frame_count=len(files) - len(without_people))


BOX, DATA = 5, "data.yaml"
"""Numbers of a line of YOLO before its landmarks, and the file that says what they are."""


def read_yolo(paths: tuple[Path, ...]) -> Poses:
    """Read YOLO's labels: a line for each detection, in fractions of the image.

    A line is class, centre and size of a box, and x, y and mostly v of each landmark; predictions
    may end in a score and a track. `kpt_shape` in the data.yaml beside the labels says how many
    landmarks there are, and whether v is given: 0 is missing, 1 and 2 are placed, fractions are
    confidences. Without v, a landmark at 0, 0 is missing.
    """
    files, images = _find_images(paths, ".txt", but="classes.txt")
    rows: list[tuple[int, list[float]]] = []
    for number, file in enumerate(files):
        for line, text in enumerate(decode(read_whole(file)).splitlines(), start=1):
            with parsing(f"{file}:{line}", "give labels of poses"):
                if cells := text.partition("#")[0].split():
                    values, wrong = read_numbers(cells)
                    require(not wrong.any(), f"{cells[int(wrong.argmax())][:40]!r} is no number")
                    rows.append((number, values.tolist()))
    data = _read_data_yaml(paths[0] if paths[0].is_dir() else paths[0].parent)
    shape: Any = data.get("kpt_shape")
    with parsing(images.name, f"put the {DATA} of the data set beside the labels"):
        count, step = _guess_shape([row for _, row in rows]) if shape is None else shape
        require(count in range(10_000) and step in (2, 3), f"kpt_shape is {shape}")
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
    names: Any = data.get("kpt_names")
    classes = data.get("names")
    if isinstance(names, dict):  # a list for each class, of which the first is taken
        names = next(iter(names.values()), None)
    named = isinstance(names, list) and len(names) == len({*map(str, names)}) == count
    people = (list(classes.values()) if isinstance(classes, dict) else classes) == ["person"]
    usual = None if count == 17 and (people or shape is None) else tuple(map(str, range(count)))
    return _as_poses(
        images,
        detections,
        scored=any({*one.numbers[2::3]} - {0, 1, 2} for one in detections),
        unit=FRACTION,
        landmark_names=tuple(map(str, names)) if named else usual,
        edges=edges_of(data.get("skeleton"), count),
    )


def _read_data_yaml(folder: Path) -> dict[str, Any]:
    """Return the nearest data.yaml in this folder or three above it, {} without; or InputError."""
    from ruamel.yaml import YAML
    from ruamel.yaml.error import YAMLError

    folder = folder.resolve()
    paths = (place / DATA for place in (folder, *folder.parents[:3]))
    path = next((path for path in paths if path.is_file()), None)
    try:
        content = YAML(typ="safe", pure=True).load(path) if path else {}
    except (YAMLError, RecursionError, ValueError) as error:
        text = " ".join(str(error).split())[:80]
        raise input_error(path or folder, f"is no YAML ({text})", "correct it") from error
    return content if isinstance(content, dict) else {}


def _guess_shape(rows: list[list[float]]) -> tuple[int, int]:
    """Return the landmarks of lines, and the numbers of each, where no data.yaml states it."""
    smallest = min((len(row) - BOX for row in rows), default=0)
    for length in (smallest, smallest - 1, smallest - 2):
        marks = {v for row in rows for v in row[BOX + 2 : BOX + length : 3]}
        if length > 0 and length % 3 == 0 and (marks <= {0, 1, 2} or length == 51):
            return length // 3, 3
    problem = f"lines of {smallest} numbers after the box, and no {DATA} with kpt_shape beside them"
    require(not rows or (smallest % 2 == 0 and smallest % 3), problem)
    return smallest // 2, 2


def _find_images(
    paths: Sequence[Path], suffix: str, but: str = ""
) -> tuple[Sequence[Path], Images]:
    """Return the files of a folder that is given as a whole, but for one, or these files, in order.

    The last number in a name is that of the frame. Names that differ in more than this number are
    of several videos, unless one of these would have a single frame: then each name is that of an
    image. Raises InputError for two files of one frame, and for links that lead nowhere, pipes and
    devices in a folder, which cannot be read whole.
    """
    folder, files = paths[0].parent, list(paths)
    if paths[0].is_dir():
        folder = paths[0]
        files = [f for f in folder.iterdir() if f.name.lower().endswith(suffix) and f.name != but]
        files = [file for file in files if not file.is_dir()]
    for file in files:
        if not file.is_file():
            problem = "leads to no file" if file.is_symlink() else "is not a regular file"
            raise input_error(file, problem, "remove it, or name the files themselves")
    name, video = str(paths[0] if len(files) == 1 else folder), folder.resolve().name
    files.sort(
        key=lambda file: [  # 9 stands before 10
            (False, int(piece), "") if piece.isdigit() else (True, 0, piece)
            for piece in re.split(r"([0-9]+)", file.name)
        ]
    )
    stems = [file.name.rpartition(".")[0] or file.name for file in files]
    series: dict[tuple[str, str], dict[int, Path]] = {}
    for file, stem in sorted(zip(files, stems, strict=True), key=lambda pair: pair[0].name):
        if match := LAST_NUMBER.match(stem):
            numbered = series.setdefault((match[1], match[3]), {})
            if (other := numbered.setdefault(int(match[2]), file)) is not file:
                problem = f"two files of frame {int(match[2])}, {other.name} and {file.name}"
                raise input_error(folder, problem, "remove or rename one of them")
    counts = [len(numbered) for numbered in series.values()]
    if sum(counts) < len(files) or (len(counts) > 1 and 1 in counts):
        unordered = not all(map(str.isdigit, stems))
        return files, Images(name, stems, [video] * len(files), range(len(files)), unordered)
    names = [video]
    if len(series) > 1:  # what files have before the number, where that differs
        names = [before.rstrip("._- ") for before, _ in series]
        if len({*names, ""}) <= len(series):
            names = [before + after for before, after in series]
    rows = [
        (numbered[number], str(number), name, number - min(numbered))
        for name, numbered in zip(names, series.values(), strict=True)
        for number in sorted(numbered)
    ]
    files, labels, videos, frames = map(list, zip(*rows, strict=True)) if rows else ([], [], [], [])
    return files, Images(name, labels, videos or [video], frames)


# One file of all images.


def read_alphapose(paths: tuple[Path, ...]) -> Poses:
    """Read AlphaPose's one file of all images: {image: {people: [{pose_keypoints_2d}]}}.

    Its layout `cmu` says `bodies` and `joints`. The folder `sep-json` beside it is OpenPose's.
    """
    contents = read_json(paths[0])
    detections: list[Detection] = []
    for number, (image, frame) in enumerate(contents.items()):
        detections += _detections(_people_of(frame), number, f"{paths[0]}: {image}")
    images = _name_images(paths[0], [*contents])._replace(unordered=False)
    return _as_poses(images, detections, alphapose=True)


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
    images = _name_images(paths[0], [*numbers])
    return _as_poses(images, detections, missing="at origin", alphapose=names)


def read_coco_annotations(paths: tuple[Path, ...]) -> Poses:
    """Read what people annotated: images, annotations, and categories with names.

    keypoints are [x, y, v, ...]; v = 0 is missing, whatever the coordinates, 1 hidden and 2
    visible. Categories may have different landmarks: then all names together, in their order.
    """
    path, contents = paths[0], read_json(paths[0])
    names_of: dict[Any, list[str]] = {}
    lines: list[tuple[str, str]] = []
    for number, category in enumerate(contents.get("categories", ())):
        with parsing(f"{path}:categories[{number}]", "give each landmark a name of its own"):
            names_of[_identifier(category["id"])] = names = [*(category.get("keypoints") or [])]
            check_names(names, "landmark")
            pairs = edges_of(category.get("skeleton"), len(names) + 1)  # counted from 1
            lines += [(names[a - 1], names[b - 1]) for a, b in pairs if a and b]
    every = dict.fromkeys(name for names in names_of.values() for name in names)
    place = {name: number for number, name in enumerate(every)}
    image_names: dict[Any, Any] = {}
    for number, image in enumerate(contents.get("images", ())):
        with parsing(f"{path}:images[{number}]", CHECK):
            image_names[_identifier(image["id"])] = image.get("file_name") or image["id"]
    order = {image: number for number, image in enumerate(image_names)}
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
    unlisted = len(order) - len(image_names)
    texts = {
        f"{counted(without, 'annotation')} without keypoints left out": without,
        f"{counted(unlisted, 'image')} of annotations not listed among the images": unlisted,
    }
    return _as_poses(
        _name_images(path, [image_names.get(image, image) for image in order]),
        detections,
        scored=False,
        landmark_names=tuple(place) or None,
        edges=tuple(dict.fromkeys((place[a], place[b]) for a, b in lines)),
        notes=tuple(text for text, number in texts.items() if number),
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
    return _as_poses(_frames_of(path, labels), detections, landmark_names=names, edges=edges)


def _frames_of(path: Path, labels: Sequence[str], video: str = "") -> Images:
    """Return the frames of a file of one video, by default called as the file."""
    video = video or path.name.partition(".")[0]
    return Images(str(path), labels, [video] * max(len(labels), 1), range(len(labels)))


def _name_images(path: Path, names: Sequence[Any]) -> Images:
    """Return the images of a file, called without folder and ending where that tells them apart."""
    stems = [Path(name).stem if isinstance(name, str) else str(name) for name in names]
    labels = stems if len({*stems}) == len(stems) else [*map(str, names)]
    return _frames_of(path, labels)._replace(unordered=not are_series(labels))


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
    images = _frames_of(path, labels, video_name(path))
    return _as_poses(images, detections, missing="unplaced", unit=None, landmark_names=names)


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
                scored = zip(points, scores, strict=True)
                points = [number for (x, y), score in scored for number in (x, y, score)]
            if len(points) % 3:
                require(False, f"a person of {len(points)} numbers, not 3 a landmark")
            detections.append(Detection(points, image, _first(person, WHO)))
    return detections


def _as_poses(
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
    who = [_identity(one.who) for one in detections]
    times = Counter((one.image, name) for one, name in zip(detections, who, strict=True) if name)
    if doubles := sum(number > 1 for number in times.values()):
        # Some tools number the people of each frame anew.
        notes += (f"numbers of people are not used, as {doubles} of them occur twice in a frame",)
        who = [""] * len(who)
    frame = np.array([images.frames[one.image] for one in detections], np.int64)
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
