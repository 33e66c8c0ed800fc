"""COCO: annotations (COCO, COCO-WholeBody, CVAT, PoseTrack, AP-10K), and results of
detectors (COCO, MMDet, AlphaPose).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Required

import numpy as np
from typing_extensions import TypedDict

from shapefit.arrays import Floats
from shapefit.errors import counted, printable
from shapefit.io.formats import Head
from shapefit.io.readers.declared import Identity, check_json
from shapefit.io.readers.detections import (
    Detection,
    person_identity,
    person_points,
    poses_from_detections,
)
from shapefit.io.readers.poses import (
    SPARSEST,
    FormatError,
    Images,
    Poses,
    as_numbers,
    check_names,
    place_images,
    require,
    skeleton_edges,
)
from shapefit.io.readers.text import read_json
from shapefit.io.skeletons import edges_of as bones_of
from shapefit.io.skeletons import installed_skeletons


class _Category(TypedDict, total=False):
    id: Required[Identity]
    name: Identity | None
    keypoints: list[str] | None
    skeleton: object


class _Image(TypedDict, total=False):
    id: Required[Identity]
    file_name: Identity | None
    vid_id: Identity | None
    video_id: Identity | None
    frame_id: object
    frame_index: object


class _Annotation(TypedDict, total=False):
    id: Identity | None
    image_id: Required[Identity]
    category_id: Identity | None
    keypoints: object
    foot_kpts: object
    face_kpts: object
    lefthand_kpts: object
    righthand_kpts: object
    track_id: object
    person_id: object
    attributes: object


class _Annotations(TypedDict, total=False):
    images: list[_Image] | None
    annotations: Required[list[_Annotation]]
    categories: list[_Category] | None


def is_coco_annotations(head: Head) -> bool:
    """Whether a file is JSON with annotations beside images or categories."""
    beside = head.keys & {"images", "categories"}
    return isinstance(head.json, dict) and "annotations" in head.keys and bool(beside)


BODY = "coco_17"
"""Skeleton of COCO."""

WHOLE_BODY = "coco_133"
"""Skeleton of COCO-WholeBody, which begins with that of COCO."""

PARTS = (
    ("foot_kpts", 6),
    ("face_kpts", 68),
    ("lefthand_kpts", 21),
    ("righthand_kpts", 21),
)
"""The lists of COCO-WholeBody beside `keypoints`, in the order of its skeleton."""


def read_coco_annotations(paths: tuple[Path, ...]) -> Poses:
    """Read COCO's JSON of annotations: images, their annotations, named categories.

    keypoints are [x, y, v, ...]; v = 0 is missing, 1 hidden and 2 visible; where one is
    a fraction, all are confidences. Categories may have different landmarks: then all
    names together, in their order. Feet, face and hands of COCO-WholeBody are landmarks
    after those of the body; what else has points is left out and named.
    """
    given = read_json(paths[0])
    content = check_json(_Annotations, given)
    assert isinstance(given, dict), "`check_json` refuses others"
    annotations = [entry for entry in content["annotations"] if entry.get("keypoints")]
    left_out: Counter[str] = Counter()
    for stated_keys in given["annotations"]:
        left_out.update(_keys_of_other_points(stated_keys))
    names = _CategoryLandmarks()
    for category in content.get("categories") or ():
        names.add(category)
    image_of = {image["id"]: image for image in content.get("images") or ()}
    order = {image: number for number, image in enumerate(image_of)}
    detections = _place_annotations(annotations, names, order, left_out)
    images = [image_of.get(image, _Image(id=image)) for image in order]
    placed_images = _find_videos(paths[0], images)
    scored = any((points[:, 2] % 1 > 0).any() for points, *_ in detections)
    if scored:
        detections = [
            (_with_confidences(points), image, who) for points, image, who in detections
        ]
    return poses_from_detections(
        placed_images,
        detections,
        scored=scored,
        landmark_names=names.landmark_names,
        edges=names.edges,
        notes=(*names.notes, *_notes_of_left_out(left_out)),
    )


def _keys_of_other_points(annotation: Mapping[str, object]) -> list[str]:
    """Return the keys of an annotation, beside `keypoints`, whose values are points."""
    return [
        key
        for key, values in annotation.items()
        if ("kpts" in key or key.startswith("keypoints"))
        and key != "keypoints"
        and _has_nonzero(values)
    ]


def _has_nonzero(values: object) -> bool:
    """Whether a value, or any value in nested lists, is a number other than 0."""
    if isinstance(values, list):
        return any(map(_has_nonzero, values))
    return isinstance(values, int | float) and values != 0


def _place_annotations(
    annotations: Sequence[_Annotation],
    names: _CategoryLandmarks,
    order: dict[Identity, int],
    left_out: Counter[str],
) -> list[Detection]:
    """Turn annotations into detections, with the landmarks of all categories.

    `order` numbers the images; those that annotations alone name are added. Lists of
    COCO-WholeBody that are read are subtracted from `left_out`.
    """
    whole = any(_has_whole_body_lists(entry) for entry in annotations)
    detections: list[Detection] = []
    for entry in annotations:
        points = _annotated_points(entry)
        if whole and len(points) == len(installed_skeletons()[BODY].landmark_names):
            points = np.concatenate([points, _points_of_parts(entry)])
            left_out.subtract(
                part for part, _ in PARTS if _has_nonzero(entry.get(part))
            )
        placed = names.place(entry, points)
        if placed is not None:
            image = order.setdefault(entry["image_id"], len(order))
            detections.append((placed, image, _identity(entry)))
    return detections


def _has_whole_body_lists(entry: _Annotation) -> bool:
    """Whether an annotation has one of the lists of COCO-WholeBody."""
    return any(entry.get(part) for part, _ in PARTS)


def _describe_entry(entry: _Annotation) -> str:
    """Return how messages name an annotation: by its id."""
    return f"annotation {entry.get('id', 'without id')}"


def _annotated_points(entry: _Annotation) -> Floats:
    """Return x, y, v (p, 3) of the keypoints of an annotation.

    They are in one list, or in one list for each keypoint. Raises FormatError for
    others.
    """
    values = as_numbers(entry["keypoints"], f"keypoints of {_describe_entry(entry)}")
    if values.ndim == 2 and values.shape[1] == 3:
        return values
    if values.ndim != 1:
        what = "pairs" if values.shape[-1:] == (2,) else "lists"
        raise FormatError(
            f"keypoints of {_describe_entry(entry)} are {what}, not x, y, v"
        )
    fits = len(values) % 3 == 0
    number = f"{len(values)} numbers, not 3 a landmark"
    require(fits, f"keypoints of {_describe_entry(entry)} are {number}")
    return values.reshape(-1, 3)


def _points_of_parts(entry: _Annotation) -> Floats:
    """Return x, y, v (116, 3) of an annotation's feet, face and hands, 0 if absent."""
    parts = []
    for part, count in PARTS:
        given = entry.get(part) or [0.0] * (3 * count)
        values = as_numbers(given, f"{part} of {_describe_entry(entry)}")
        fits = values.shape == (3 * count,)
        require(fits, f"{part} of {_describe_entry(entry)} are not {count} landmarks")
        parts.append(values.reshape(count, 3))
    return np.concatenate(parts)


def _identity(entry: _Annotation) -> object:
    """Return the track id of an annotation, as of PoseTrack or CVAT; None without."""
    attributes = entry.get("attributes")
    stated: list[object] = [entry.get("track_id"), entry.get("person_id")]
    if isinstance(attributes, dict):
        stated.append(attributes.get("track_id"))
    return next((who for who in stated if who is not None), None)


def _find_videos(path: Path, images: Sequence[_Image]) -> Images:
    """Return images with video and frame, as they state them or by their file names."""
    videos = [_stated_video(image) for image in images]
    named = any(video is not None for video in videos)
    return place_images(
        path,
        [str(image.get("file_name") or image["id"]) for image in images],
        [str(video) for video in videos] if named else None,
        stated=[_stated_frame(image) for image in images],
    )


def _stated_video(image: _Image) -> Identity | None:
    """Return the id of the video of an image; None where it states none."""
    return image.get("vid_id") or image.get("video_id") or None


def _stated_frame(image: _Image) -> int | None:
    """Return the frame number of an image; None where it states none."""
    numbers = (image.get("frame_id"), image.get("frame_index"))
    return next((n for n in numbers if isinstance(n, int) and n >= 0), None)


def _with_confidences(points: Floats) -> Floats:
    """Return x, y, v (p, 3) with v clipped to 1, as a confidence."""
    return np.column_stack([points[:, :2], np.minimum(points[:, 2], 1.0)])


def _notes_of_left_out(left_out: Mapping[str, int]) -> list[str]:
    """Return a note for each key of annotations whose points are not read.

    left_out: key -> number of annotations.
    """
    return [
        f"{printable(key)} of {counted(number, 'annotation')} left out"
        for key, number in sorted(left_out.items())
        if number
    ]


@dataclass
class _CategoryLandmarks:
    """The landmarks of all categories together, and the columns of each category.

    The arrays of points have a column for each landmark name of any category.
    """

    column_of: dict[str, int] = field(default_factory=dict)
    columns: dict[Identity, list[int]] = field(default_factory=dict)
    names: dict[Identity, str] = field(default_factory=dict)
    pairs: dict[tuple[int, int], None] = field(default_factory=dict)
    unnamed: Counter[str] = field(default_factory=Counter)
    unknown: Counter[str] = field(default_factory=Counter)
    whole_body: bool = False

    def add(self, category: _Category) -> None:
        """Add the landmarks of a category, and its edges."""
        given = category.get("keypoints") or []
        check_names(given, "landmark")
        here = [self.column_of.setdefault(name, len(self.column_of)) for name in given]
        self.columns[category["id"]] = here
        self.names[category["id"]] = str(category.get("name") or category["id"])
        lines = category.get("skeleton")
        listed = lines if isinstance(lines, list) else []
        # COCO counts from 1, some tools from 0
        zeros = any(0 in line for line in listed if isinstance(line, list))
        for a, b in skeleton_edges(lines, len(given), first=0 if zeros else 1):
            self.pairs[here[a], here[b]] = None

    def place(self, entry: _Annotation, points: Floats) -> Floats | None:
        """Place x, y, v of an annotation among all landmarks (p, 3), 0 for others.

        They stay as they are where no category names any. None for an annotation that
        is left out, as its category names none. Raises FormatError for another number.
        """
        if not self.column_of:
            return points
        columns = self._columns_of(entry)
        if columns is None:
            return None
        if self._is_whole_body(columns, len(points)):
            return points
        known = self.names.get(entry.get("category_id") or 0)
        owner = "the categories name" if known is None else f"category {known} names"
        landmarks = counted(len(points), "landmark")
        require(
            len(columns) == len(points),
            f"{_describe_entry(entry)} has {landmarks}, and {owner} {len(columns)}",
            "correct the keypoints of the category, or of the annotations",
        )
        placed = np.zeros((len(self.column_of), 3))
        placed[columns] = points
        return placed

    def _columns_of(self, entry: _Annotation) -> Sequence[int] | None:
        """Return the columns of an annotation's landmarks; None if it must be left out.

        Those of its category, or of an unknown one those that all share, which is
        counted for `notes`. Raises FormatError where they do not share them.
        """
        category = entry.get("category_id")
        columns = self.columns.get(category) if category is not None else None
        shared = {tuple(some) for some in self.columns.values()}
        if columns is None and len(shared) == 1:
            absent = f"of category {category}, which is not among the categories,"
            self.unknown["without a category" if category is None else absent] += 1
            return next(iter(self.columns.values()))
        if columns is None:
            problem = f"{_describe_entry(entry)} is of category {category}"
            fix = "add the category, with the names of its keypoints"
            raise FormatError(f"{problem}, which is not among the categories", fix)
        if not columns:
            self.unnamed[self.names[category or 0]] += 1
            return None
        return columns

    def _is_whole_body(self, columns: Sequence[int], count: int) -> bool:
        """Whether a category of the body's names has the landmarks of COCO-WholeBody.

        columns are those of the category, count is the number of landmarks. Once true,
        it is stored in `whole_body`.
        """
        skeletons = installed_skeletons()
        body = skeletons[BODY].landmark_names
        named = tuple(self.column_of) == body and len(columns) == len(body)
        whole = named and count == len(skeletons[WHOLE_BODY].landmark_names)
        self.whole_body |= whole
        return whole

    @property
    def landmark_names(self) -> tuple[str, ...] | None:
        """The names of all landmarks; None where the file has none."""
        if self.whole_body:
            return installed_skeletons()[WHOLE_BODY].landmark_names
        return tuple(self.column_of) or None

    @property
    def edges(self) -> tuple[tuple[int, int], ...]:
        """Index pairs of landmarks that the skeletons of categories join."""
        if self.whole_body:
            return bones_of(installed_skeletons()[WHOLE_BODY].landmark_names)
        return tuple(self.pairs)

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes on annotations left out, and on those without a known category."""
        left_out = [
            f"{counted(number, 'annotation')} of category {printable(name)} left out,"
            " which names no keypoints"
            for name, number in self.unnamed.items()
        ]
        assumed = [
            f"{counted(number, 'annotation')} {printable(kind)} taken to have the"
            " landmarks of the others"
            for kind, number in self.unknown.items()
        ]
        return (*left_out, *assumed)


class _Result(TypedDict, total=False):
    image_id: Required[Identity]


def is_coco_results(head: Head) -> bool:
    """Whether a file is a JSON list of objects with image_id and keypoints."""
    return isinstance(head.json, list) and {"image_id", "keypoints"} <= head.keys


SPARSEST_IDS = 10
"""How many numbers of images there are at most for each that is there, if they are
frames; COCO's own are a choice of many images.
"""


def read_coco_results(paths: tuple[Path, ...]) -> Poses:
    """Read COCO's list of {image_id, category_id, keypoints, score}.

    MMDet and AlphaPose write it.

    A landmark of 0, 0, 0 is missing, others of confidence 0 have no weight. Where the
    images differ in a number, it is that of the frame; images of numbers that are no
    frames are in their order.
    """
    content = read_json(paths[0])
    check_json(list[_Result], content)
    assert isinstance(content, list), "`check_json` refuses others"
    number_of: dict[Identity, int] = {}
    detections: list[Detection] = []
    for entry in content:
        image = number_of.setdefault(entry["image_id"], len(number_of))
        points = person_points(entry, needed=True)
        detections.append((points, image, person_identity(entry)))
    # Numbers of images alone are those of frames only where few are absent.
    numbered = all(isinstance(image, int) for image in number_of)
    if numbered:
        ranked = {image: rank for rank, image in enumerate(sorted(number_of))}
        place = [ranked[image] for image in number_of]
        detections = [(points, place[i], who) for points, i, who in detections]
        number_of = ranked
    images = place_images(
        paths[0],
        [*map(str, number_of)],
        sparsest=SPARSEST_IDS if numbered else SPARSEST,
    )
    return poses_from_detections(images, detections, hide_unscored=False)
