"""Detections of people and animals: OpenPose, AlphaPose, COCO, MMPose, MediaPipe; what all share.

Their tools write x, y and a confidence of each landmark, the people of a frame in any order, as a
rule without an identity over frames. They differ in where the people of a frame stand.
"""

from __future__ import annotations

import math
import os
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Floats
from shapefit.errors import abbreviate, counted, input_error, listed
from shapefit.io.layout import UNKNOWN_UNIT
from shapefit.io.readers.json_file import read_json
from shapefit.io.readers.poses import (
    FRACTION,
    Poses,
    are_fractions,
    check_names,
    edges_of,
    parsing,
    require,
    video_name,
)
from shapefit.io.skeletons import skeletons_of_size

CHECK = "check what wrote the file"


class Image(NamedTuple):
    """An image: its file, its video, its position there, and what the file calls it."""

    path: Path
    video: str
    frame: int
    label: str


class Images(NamedTuple):
    """The images of one recording, in order; the name is for messages."""

    name: str
    video: str
    images: list[Image]
    unordered: bool = False


class Detection(NamedTuple):
    """x, y and confidence of each landmark, none where nothing was found; the image; who it is."""

    numbers: Sequence[float]
    image: int
    who: Any = None


# One file per image.


def read_openpose(paths: tuple[Path, ...]) -> Poses:
    """Read a file per frame, with the people found in it; Pose2Sim, Sports2D and RTMLib write it.

    A landmark of 0, 0, 0 is missing. A person is a number from frame to frame only where
    `person_id` is not -1.
    """
    images = images_in(paths, ".json")
    found: list[Detection] = []
    strange: list[str] = []
    further = 0
    for number, image in enumerate(images.images):
        people = _people_of(read_json(image.path))
        if people is None:
            strange.append(image.path.name)
        else:
            found += _people(people, number, image.path)
            further += sum(any(person.get(key) for key in OTHERS) for person in people)
    notes: tuple[str, ...] = ()
    if strange:
        lost = f"{counted(len(strange), 'file')} without people left out ({abbreviate(strange)})"
        notes += (lost,)
    if further:
        notes += (f"hands and faces left out, of {counted(further, 'detection')}",)
    return as_poses(images, found, notes=notes, lost=len(strange))


OTHERS = ("face_keypoints_2d", "hand_left_keypoints_2d", "hand_right_keypoints_2d")


def read_mmpose_images(paths: tuple[Path, ...]) -> Poses:
    """Read a list of instances per image: those of a folder, or these files."""
    images = images_in(paths, ".json")
    found: list[Detection] = []
    for number, image in enumerate(images.images):
        found += _people(read_json(image.path), number, image.path, needed=True)
    return as_poses(images, found)


# One file of all images.


def read_alphapose(paths: tuple[Path, ...]) -> Poses:
    """Read AlphaPose's one file of all images, in the layouts `open` and `cmu`.

    {image: {version, people: [{pose_keypoints_2d}]}} or {image: {version, bodies: [{joints}]}}; the
    folder `sep-json` beside it has a file for each image, which is OpenPose's layout.
    """
    contents = read_json(paths[0])
    images = named_images(paths[0], {image: image for image in contents})
    found: list[Detection] = []
    for number, (image, frame) in enumerate(contents.items()):
        found += _people(_people_of(frame), number, f"{paths[0]}: {image}")
    values, notes = _scaled(values_of(found, images.name), [*contents])
    return as_poses(images._replace(unordered=False), found, values, notes=notes)


def read_coco_results(paths: tuple[Path, ...]) -> Poses:
    """Read a list of {image_id, category_id, keypoints, score}, as MMDet and AlphaPose write it.

    Images stand in the order of their first appearance. Confidences are taken as they are; a
    landmark of 0, 0, 0 is missing, others of confidence 0 have no weight.
    """
    found: list[Detection] = []
    numbers: dict[Any, int] = {}
    for row, entry in enumerate(read_json(paths[0])):
        place = f"{paths[0]}:[{row}]"
        with parsing(place, "give COCO results of keypoints"):
            require(isinstance(entry["keypoints"], list), "no keypoints")
            image = numbers.setdefault(_image(entry["image_id"]), len(numbers))
        found += _people([entry], image, place)
    images = named_images(paths[0], {image: image for image in numbers})
    values, notes = _scaled(values_of(found, images.name), [*numbers])
    at_origin = np.isin(values[..., :2], (0, -1)).all(axis=2) & (values[..., 2] == 0)
    missing = np.asarray(at_origin | np.isnan(values).any(axis=2))
    return as_poses(images, found, values, missing, notes=notes)


def read_coco_annotations(paths: tuple[Path, ...]) -> Poses:
    """Read what people annotated: images, annotations, and categories with names.

    keypoints are [x, y, v, ...]; v = 0 is missing, whatever the coordinates, 1 hidden and 2
    visible. Categories may have different landmarks: then all names together, in their order.
    """
    path = paths[0]
    contents = read_json(path)
    listed_images, annotations, categories = (
        contents.get(key, []) for key in ("images", "annotations", "categories")
    )
    names_of: dict[Any, list[str]] = {}
    for number, category in enumerate(categories):
        with parsing(f"{path}:categories[{number}]", "give each landmark a name of its own"):
            names_of[_image(category["id"])] = [*(category.get("keypoints") or [])]
            check_names(names_of[category["id"]], "landmark")
    names = tuple(dict.fromkeys(name for own in names_of.values() for name in own))
    columns = {key: [names.index(name) for name in own] for key, own in names_of.items() if own}
    called: dict[Any, Any] = {}
    for number, image in enumerate(listed_images):
        with parsing(f"{path}:images[{number}]", CHECK):
            called[_image(image["id"])] = image.get("file_name") or image["id"]
    order = {image: number for number, image in enumerate(called)}
    found = []
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
            found.append(Detection(keypoints, order.setdefault(image, len(order)), _track(entry)))
    notes: tuple[str, ...] = ()
    if without:
        notes += (f"{counted(without, 'annotation')} without keypoints left out",)
    if unlisted := len(order) - len(called):
        notes += (f"{counted(unlisted, 'image')} of annotations not listed among the images",)
    edges: dict[tuple[int, int], None] = {}
    for category in categories:  # which count landmarks from 1
        own = columns.get(category.get("id"), [])
        pairs = edges_of(category.get("skeleton"), len(own) + 1)
        edges |= dict.fromkeys((own[a - 1], own[b - 1]) for a, b in pairs if a and b)
    images = named_images(path, {image: called.get(image, image) for image in order})
    return as_poses(
        images, found, scored=False, landmark_names=names or None, edges=tuple(edges), notes=notes
    )


def _track(entry: Mapping[str, Any]) -> Any:
    """Return who an annotation is of: CVAT's and sleap-io's stand among its attributes."""
    attributes = entry.get("attributes")
    if "track_id" in entry or not isinstance(attributes, dict):
        return entry.get("track_id")
    return attributes.get("track_id", attributes.get("object_id"))


def _spread(keypoints: list[float], columns: list[int], count: int) -> list[float]:
    """Return keypoints of a category among the landmarks of all categories."""
    given = f"{len(keypoints)} numbers for {len(columns)} landmarks"
    require(len(keypoints) == 3 * len(columns), given)
    spread = [0.0] * (3 * count)
    for number, column in enumerate(columns):
        spread[3 * column : 3 * column + 3] = keypoints[3 * number : 3 * number + 3]
    return spread


def read_mmpose_video(paths: tuple[Path, ...]) -> Poses:
    """Read a list of {frame_id, instances}, which may stand as `instance_info` beside `meta_info`.

    An instance has keypoints [[x, y], ...] and keypoint_scores, which are taken as they are; they
    may be a little above 1. `meta_info` has the names, by number, as texts or in a list.
    """
    path, meta = paths[0], None
    contents = read_json(path)
    if isinstance(contents, dict):
        meta, contents = contents.get("meta_info"), contents["instance_info"]
    if contents and "instances" not in contents[0]:
        contents = [{"frame_id": 0, "instances": contents}]
    found: list[Detection] = []
    labels = []
    for number, frame in enumerate(contents):
        with parsing(f"{path}:[{number}]", CHECK):
            label, people = frame.get("frame_id"), frame["instances"]
        labels.append(str(number if label is None else label))
        found += _people(people, number, f"{path}:[{number}]", needed=True)
    images = numbered_images(path, path.name.partition(".")[0], labels)
    values = values_of(found, images.name)
    count = values.shape[1]
    meta = meta if isinstance(meta, dict) else {}
    known = meta.get("keypoint_id2name")
    if isinstance(known, dict):
        known = [known.get(str(number)) for number in range(count)]
    known = known if isinstance(known, list) and all(isinstance(n, str) for n in known) else []
    names = tuple(known) if len(known) == len({*known}) == count else None
    edges = edges_of(meta.get("skeleton_links"), count) if names else ()
    return as_poses(images, found, values, landmark_names=names, edges=edges)


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
    contents = read_json(paths[0])
    if isinstance(contents, dict):
        lists = (contents[key] for key in FRAMES if isinstance(contents.get(key), list))
        contents = next(lists, [contents])
    elif _is_body(contents):
        contents = [contents]
    bodies = [(body, n) for n, frame in enumerate(contents) for body in _bodies(frame)]
    names: list[Any] = [point.get("name") for point in bodies[0][0]] if bodies else []
    named = all(isinstance(name, str) and name for name in names) and len({*names}) == len(names)
    labels = [str(number) for number in range(len(contents))]
    return _of_points(paths[0], labels, bodies, tuple(names) if named and names else None)


def read_named_points(paths: tuple[Path, ...]) -> Poses:
    """Read {frame: {landmark: point}}, or a list of the inner objects, one body per frame.

    A point is [x, y], [x, y, confidence] or {x, y, confidence}; a landmark that a frame lacks is
    missing.
    """
    contents = read_json(paths[0])
    labels = [*contents] if isinstance(contents, dict) else [*map(str, range(len(contents)))]
    frames = [*(contents.values() if isinstance(contents, dict) else contents)]
    names = tuple(dict.fromkeys(name for frame in frames for name in frame))
    bodies = []
    for number, frame in enumerate(frames):
        with parsing(f"{paths[0]}: {labels[number]}", "give [x, y] or [x, y, confidence]"):
            require(isinstance(frame, dict), "no object of landmarks")
            bodies.append(([_as_point(frame.get(name)) for name in names], number))
    return _of_points(paths[0], labels, bodies, names)


def _as_point(point: Any) -> dict[str, Any]:
    if isinstance(point, list):
        require(len(point) in (2, 3), f"a point of {len(point)} numbers")
        return dict(zip(("x", "y", "score"), point, strict=False))
    require(point is None or (isinstance(point, dict) and {"x", "y"} <= point.keys()), "no point")
    return point or {}


def _of_points(
    path: Path,
    labels: Sequence[str],
    bodies: Sequence[tuple[Sequence[dict[str, Any]], int]],
    names: tuple[str, ...] | None,
) -> Poses:
    """Return the poses of bodies of points {x, y, visibility or the like}, and the frame of each.

    A point without a confidence has that of 1.
    """
    found = []
    for body, number in bodies:
        rows = [(point.get("x"), point.get("y"), _first(point, SCORES, 1.0)) for point in body]
        numbers = [math.nan if value is None else value for row in rows for value in row]
        found.append(Detection(numbers, number))
    values = values_of(found, str(path))
    fractions = are_fractions(values[np.isfinite(values).all(axis=2)][:, :2])
    return as_poses(
        numbered_images(path, video_name(path), labels),
        found,
        values,
        np.asarray(np.isnan(values[..., :2]).any(axis=2)),
        unit=FRACTION if fractions else UNKNOWN_UNIT,
        size_needed=fractions,
        landmark_names=names,
    )


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


def _people(people: Any, image: int, place: str | Path, *, needed: bool = False) -> list[Detection]:
    """Return the people of an image, who may have no landmarks unless they are `needed`.

    The landmarks of each are x, y, confidence in one list, or [x, y] beside `keypoint_scores`.
    """
    found = []
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
            require(len(points) % 3 == 0, f"a person of {len(points)} numbers, not 3 a landmark")
            found.append(Detection(points, image, _first(person, WHO)))
    return found


def _image(image: Any) -> Any:
    """Return what identifies an image. Raises FormatError for what cannot."""
    require(isinstance(image, int | float | str), f"no image ({str(image)[:40]})")
    return image


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


def values_of(found: Sequence[Detection], name: str) -> Floats:
    """Return the numbers (N, p, 3), NaN where a detection has none or they are not finite.

    Raises InputError where detections have different numbers of landmarks, and for texts.
    """
    sizes = Counter(len(each.numbers) for each in found if each.numbers)
    if len(sizes) > 1:
        kinds = [f"{n} detections with {s // 3}" for s, n in sorted(sizes.items())]
        fix = "give the files of each skeleton in a separate call"
        raise input_error(name, f"several skeletons: {listed(kinds, 'and')} landmarks", fix)
    width = next(iter(sizes), 0)
    nothing = [math.nan] * width
    with parsing(name, CHECK):
        values = np.array([each.numbers or nothing for each in found], dtype=np.float64)
        values = values.reshape(len(found), width // 3, 3)
    return np.where(np.isfinite(values), values, np.nan)


def as_poses(
    images: Images,
    found: Sequence[Detection],
    values: Floats | None = None,
    missing: NDArray[np.bool_] | None = None,
    *,
    scored: bool = True,
    lost: int = 0,
    notes: tuple[str, ...] = (),
    unit: str = "px",
    landmark_names: tuple[str, ...] | None = None,
    **known: Any,
) -> Poses:
    """Return detections as poses.

    values (N, p, 3) are x, y and the confidence, by default those of the detections, and `missing`
    (N, p) by default those without confidence; the others say how sure they are where they are
    `scored`. Where nobody was found there are no poses, and a note; `lost` images do not count.
    Without names landmarks are those of the usual skeleton of so many.
    """
    values = values_of(found, images.name) if values is None else values
    missing = np.asarray(~(values[..., 2] > 0)) if missing is None else missing
    count = len(images.images) - lost
    if not values.size:
        notes += (f"nobody was found in {counted(count, 'frame')}",)
        found, values, missing = (), np.empty((0, 0, 3)), np.empty((0, 0), bool)
        scored, landmark_names, unit, known = False, (), "px", {}
    who = [_identity(each.who) for each in found]
    twice = Counter((each.image, name) for each, name in zip(found, who, strict=True) if name)
    if doubles := sum(number > 1 for number in twice.values()):
        # Some tools number the people of each frame anew.
        notes += (f"numbers of people are not used, as {doubles} of them occur twice in a frame",)
        who = [""] * len(who)
    shown = [images.images[each.image] for each in found]
    videos = {video: number for number, video in enumerate(dict.fromkeys(i.video for i in shown))}
    frame = np.array([image.frame for image in shown], dtype=np.int64)
    usual = None if landmark_names else next(iter(skeletons_of_size(values.shape[1])), None)
    several = len({image.video for image in images.images}) > 1
    poses = Poses(
        name=images.name,
        video=[image.video for image in shown] if several else images.video,
        points=np.where(missing[..., None], np.nan, values[..., :2]),
        confidence=np.where(missing, 0.0, np.nan_to_num(values[..., 2])) if scored else None,
        frame=frame,
        label=[image.label for image in shown],
        individual=who,
        landmark_names=landmark_names,
        skeleton=usual,
        frame_count=count,
        unit=unit,
        unordered=images.unordered,
        notes=notes,
        **known,
    )
    return poses.take(np.lexsort((frame, np.array([videos[i.video] for i in shown], np.int64))))


def _identity(who: Any) -> str:
    """Return an identity as text, "" for none: a number, a text, or a list of one of them."""
    while isinstance(who, list) and len(who) == 1:
        who = who[0]
    if isinstance(who, bool) or not isinstance(who, int | float | str):
        return ""
    if isinstance(who, str):
        return who
    return "" if who < 0 or who != who else f"id {who:g}"


def numbered_images(path: Path, video: str, labels: Sequence[str]) -> Images:
    """Return the frames of a file of one video."""
    return Images(str(path), video, [Image(path, video, n, text) for n, text in enumerate(labels)])


def named_images(path: Path, called: Mapping[Any, Any]) -> Images:
    """Return the images of a file: id -> what it is called, in order.

    They have these names without folder and ending where that tells them apart.
    """
    names = [Path(name).stem if isinstance(name, str) else str(name) for name in called.values()]
    if len(set(names)) < len(names):
        names = list(map(str, called.values()))
    images = numbered_images(path, path.name.partition(".")[0], names)
    return images._replace(unordered=not are_series(names))


_LAST_NUMBER = re.compile(r"^(.*?)([0-9]{1,18})([^0-9]*)$", re.DOTALL)
_DIGITS = re.compile(r"([0-9]+)")

MOST_APART = 100
"""Numbers per image, between the least and the largest, of what is a series of frames."""


def are_series(names: Sequence[str]) -> bool:
    """Whether names differ in one number, by which they can be the frames of a video."""
    matches = [_LAST_NUMBER.match(name) for name in names]
    parts = {(match[1], match[3]) for match in matches if match}
    numbers = {int(match[2]) for match in matches if match}
    if None in matches or len(parts) > 1 or len(numbers) < len(names):
        return False
    return not numbers or max(numbers) - min(numbers) < MOST_APART * len(numbers)


def images_in(paths: Sequence[Path], suffix: str, but: str = "") -> Images:
    """Return the files of a folder that is given as a whole, but for one, or these files.

    Raises InputError for two files of one frame, and for links that lead nowhere, pipes and devices
    in a folder, which cannot be read whole.
    """
    folder = paths[0] if paths[0].is_dir() else paths[0].parent
    files = list(paths)
    if paths[0].is_dir():
        with os.scandir(folder) as entries:
            names = [each.name for each in entries if each.name.lower().endswith(suffix)]
        files = [folder / name for name in names if name != but]
        files = [path for path in files if not path.is_dir()]
    for path in files:
        if not path.is_file():
            what = "leads to no file" if path.is_symlink() else "is not a regular file"
            raise input_error(path, what, "remove it, or name the files themselves")
    video = folder.resolve().name
    images = _in_series(files, video)
    unordered = not all(image.label.isdigit() for image in images)
    return Images(str(paths[0] if len(files) == 1 else folder), video, images, unordered)


def _in_series(paths: Sequence[Path], folder: str) -> list[Image]:
    """Return files in order of videos and frames; `folder` is the name of a single video.

    The last number in a name is that of the frame. Names that differ in more than this number are
    of several videos, unless one of these would have a single frame: then each name is that of an
    image. Raises InputError where two files have the same number.
    """
    series: dict[tuple[str, str], dict[int, Path]] = {}
    stems = [path.name.rpartition(".")[0] or path.name for path in paths]
    matches = [_LAST_NUMBER.match(stem) for stem in stems]
    for path, match in sorted(zip(paths, matches, strict=True), key=lambda each: each[0].name):
        if match is None:
            continue
        files, number = series.setdefault((match[1], match[3]), {}), int(match[2])
        if (other := files.setdefault(number, path)) is not path:
            found = f"two files of frame {number}, {other.name} and {path.name}"
            raise input_error(path.parent, found, "remove or rename one of them")
    if None in matches or (len(series) > 1 and any(len(files) == 1 for files in series.values())):
        natural = sorted(zip(paths, stems, strict=True), key=lambda each: _natural(each[0].name))
        return [Image(path, folder, n, stem) for n, (path, stem) in enumerate(natural)]
    names = [folder]
    if len(series) > 1:  # what files have before the number, where that differs
        names = [before.rstrip("._- ") for before, _ in series]
        if len({*names, ""}) <= len(series):
            names = [before + after for before, after in series]
    return [
        Image(files[number], name, number - min(files), str(number))
        for name, files in zip(names, series.values(), strict=True)
        for number in sorted(files)
    ]


def _natural(name: str) -> list[tuple[int, int, str]]:
    """Return a key by which 9 comes before 10."""
    pieces = _DIGITS.split(name)
    return [(0, int(piece), "") if piece.isdigit() else (1, 0, piece) for piece in pieces]
