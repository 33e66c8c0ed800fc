"""The numbers of the files and the truth, frame by frame, with the landmarks of all of them."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Floats
from shapefit.config import ViewConfig
from shapefit.errors import input_error
from shapefit.io import open_shapes
from shapefit.io.layout import FRAME, INPUT_NAMES, METRES_PER_UNIT
from shapefit.io.listing import AnyRecords, Listing, read_rows
from shapefit.io.options import input_options
from shapefit.io.records import LandmarkSet, ResultSet, ShapeSet
from shapefit.io.skeletons import people_joints
from shapefit.io.source import open_results
from shapefit.lifting.verdict import REASONS
from shapefit.pipelines.evaluate.judge import common_landmarks, with_shapes_of
from shapefit.pipelines.items import BY_FRAME, BY_ITEM, Keys, find_truth, keys_of

CAMERA = ("camera_translation", "focal", "principal_point")
"""Datasets that describe how a camera sees the shapes of a result in perspective."""
AT_A_TIME = 1 << 14
"""True shapes that are read at a time for their names."""
POSE = ("coefficients", "rotation", "translation", "scale")
IMAGE_SIZE = "image_size"
OF_IMAGES = (*POSE, *CAMERA, "p_value", "expected_error", METRES_PER_UNIT)
OF_RESULTS = frozenset({"sequence", "landmarks_fitted", "status", "shape_sd", *POSE})
"""Datasets of a result that a page is made of, beside those that the format does not know."""


@dataclass(frozen=True)
class Frames:
    """Items in the order of the page; sequences (name, first frame) cover them all.

    About every `step`-th frame of `count` is here; index is the frame of each item.
    """

    items: tuple[str, ...]
    sequences: tuple[tuple[str, int], ...]
    count: int
    step: int
    index: Mapping[str, int]

    @classmethod
    def of(cls, groups: Mapping[str, Sequence[str]], count: int, step: int = 1) -> Frames:
        """Return the frames of these sequences, one after the other."""
        items = tuple(chain.from_iterable(groups.values()))
        starts = np.cumsum([0, *(len(members) for members in groups.values())])[:-1]
        sequences = tuple(zip(groups, starts.tolist(), strict=True))
        return cls(items, sequences, count, step, {item: n for n, item in enumerate(items)})


@dataclass
class Gathered:
    """What one or several files of a name say about the n frames, nan or "" where nothing.

    points (n, 3, p) with the p landmarks of the page; `of_frames` holds other numbers by name, each
    (n, ...), those of landmarks (n, ..., p); texts the same for texts. Frame f has the vertices
    mesh_vertices[f] (3, q), where there are any; image_size (2) is the width and height of images.
    """

    name: str
    kind: str
    listings: tuple[Listing, ...]
    points: Floats
    of_frames: dict[str, Floats] = field(default_factory=dict)
    texts: dict[str, NDArray[Any]] = field(default_factory=dict)
    mesh_vertices: dict[int, Floats] = field(default_factory=dict)
    mesh_faces: NDArray[np.int64] | None = None
    edges: NDArray[np.int64] | None = None
    landmark_names: tuple[str, ...] = ()
    y_down: bool = True
    image_size: Floats | None = None

    @property
    def stated(self) -> Mapping[str, Any]:
        """Return the keys of the config of the fit that are not left open, as the file has them."""
        try:
            config = json.loads(str(self.attributes.get("config", "{}")))
        except (ValueError, RecursionError):
            return {}
        known = config.items() if isinstance(config, dict) else ()
        return {name: value for name, value in known if value is not None}

    @property
    def attributes(self) -> Mapping[str, Any]:
        """Return the root attributes of the first file."""
        return self.listings[0].attributes


def gather(
    name: str, listings: Sequence[Listing], frames: Frames, landmarks: Sequence[str], match: str
) -> Gathered:
    """Read the frames from the files of one name, also the dataset `match` of the items.

    Raises InputError for an item that two of the files have.
    """
    n, p = len(frames.items), len(landmarks)
    gathered = Gathered(name, listings[0].kind, tuple(listings), np.full((n, 3, p), np.nan))
    gathered.landmark_names = tuple(landmarks)
    gathered.y_down = listings[0].kind != "shapes" and listings[0].y_axis != "up"
    owner = np.full(n, -1)
    column = {landmark: number for number, landmark in enumerate(landmarks)}
    for number, listing in enumerate(listings):
        found = [frames.index.get(item, -1) for item in listing.items]
        at = np.array(found, dtype=np.intp)
        rows, at = np.flatnonzero(at >= 0), at[at >= 0]
        if (again := at[owner[at] >= 0]).size:
            other = listings[owner[again[0]]].path
            twice = f"has the item '{frames.items[again[0]]}', which {other} has too"
            raise input_error(listing.path, twice, "give each file a unique name in `files`")
        owner[at] = number
        records = read_rows(listing, OF_RESULTS, rows)
        if isinstance(records, ResultSet) and records.landmark_names != listing.landmark_names:
            records = _of_the_input(records, listing.landmark_names)
        columns = np.array([column[each] for each in listing.landmark_names], dtype=np.intp)
        _take(gathered, records, at, columns, match)
    return gathered


def _of_the_input(records: ResultSet, names: Sequence[str]) -> ResultSet:
    """Return a result of joints with the landmarks of its input, observed where they are joints."""
    shown = with_shapes_of(records, names).without(["edges"])
    seen = records.columns.get("landmarks")
    if seen is None:
        return shown
    column = {joint: number for number, joint in enumerate(records.landmark_names)}
    joints = people_joints(names)
    own = [column.get(joints.get(name, name), -1) for name in names]
    known = np.where(np.array(own)[:, None] >= 0, seen[:, own], np.nan)
    return shown.with_columns({"landmarks": known})


def _take(
    gathered: Gathered,
    records: AnyRecords,
    at: NDArray[np.intp],
    columns: NDArray[np.intp],
    match: str,
) -> None:
    """Put the records in the places `at` of their frames, and `columns` of their landmarks."""
    n, _, p = gathered.points.shape
    own = records.columns

    def put(name: str, values: Any) -> None:
        """Put values (rows, ...) of images."""
        values = np.asarray(values, dtype=np.float64)
        gathered.of_frames.setdefault(name, np.full((n, *values.shape[1:]), np.nan))[at] = values

    def put_landmarks(name: str, values: Any) -> None:
        """Put values (rows, ..., p) of the file's landmarks under those of the page."""
        values = np.asarray(values, dtype=np.float64)
        whole = gathered.of_frames.setdefault(name, np.full((n, *values.shape[1:-1], p), np.nan))
        whole[at[:, None], ..., columns] = np.moveaxis(values, -1, 1)

    if FRAME in own and own[FRAME].shape == at.shape and own[FRAME].dtype.kind in "iuf":
        put(FRAME, own[FRAME])
    if isinstance(records, LandmarkSet):
        seen = records.landmarks
        if records.confidence is not None:
            seen = np.where(records.confidence[:, None] > 0, seen, np.nan)
        put_landmarks("landmarks", seen)
    else:
        gathered.points[at[:, None], :, columns] = records.shapes.swapaxes(1, 2)
    if isinstance(records, ShapeSet) and records.mesh_faces is not None:
        gathered.mesh_vertices |= dict(zip(at.tolist(), own["mesh_vertices"], strict=True))
        gathered.mesh_faces = records.mesh_faces
    if isinstance(records, ResultSet):
        for name in OF_IMAGES:
            if own.get(name) is not None:
                put(name, own[name])
        for name in ("shape_sd", "landmarks_fitted", "outliers"):
            if own.get(name) is not None:
                put_landmarks(name, own[name])
        if "landmarks" in own:
            put_landmarks("landmarks", np.swapaxes(own["landmarks"], 1, 2))
        for name in ("status", REASONS, match):
            if name in own and own[name].shape == at.shape:
                texts = gathered.texts.setdefault(name, np.full(n, "", dtype=object))
                texts[at] = own[name].astype(str)
    if IMAGE_SIZE in own and own[IMAGE_SIZE].shape[-1:] == (2,):
        gathered.image_size = np.asarray(own[IMAGE_SIZE], np.float64).reshape(-1, 2)[0]
    if records.lines is not None:
        gathered.edges = columns[records.lines]


@dataclass(frozen=True)
class Truth:
    """The true shapes of the frames; rows (n), that of each frame, -1 where there is none.

    points (n, 3, p) with the p landmarks of the page.
    """

    shapes: ShapeSet
    rows: NDArray[np.intp]
    points: Floats
    frame_rate: float | None


def as_judged(config: ViewConfig, listing: Listing) -> Listing:
    """Return a result with the landmarks that `eval` compares with the truth of the config.

    Those are a detector's landmarks, where more of the truth's names are of these than of joints.
    """
    if not config.truth or listing.kind != "result" or INPUT_NAMES not in listing.datasets:
        return listing
    with open_shapes(config.truth, input_options(config), gaps=True) as source:
        names = source.head.landmark_names
    with open_results([listing.path]) as results:
        judged = with_shapes_of(results.head, names)
    return replace(listing, landmark_names=judged.landmark_names)


def read_truth(
    config: ViewConfig, results: Sequence[Gathered], frames: Frames, landmarks: Sequence[str]
) -> Truth:
    """Read the truth of the frames. Raises InputError where there is none of any."""
    own = _keys(config.match, results, frames)
    place = results[0].listings[0].path
    with open_shapes(config.truth, input_options(config), gaps=True) as source:
        if config.match == BY_FRAME:
            keys = keys_of(source.batches(AT_A_TIME))
        else:
            keys = Keys(list(chain.from_iterable(source.names())))
        common_landmarks(place, landmarks, source.head.landmark_names)
        unique, places = np.unique(find_truth(place, config.match, own, keys), return_inverse=True)
        unknown = int(unique[0] < 0)
        shapes, frame_rate = source.take(unique[unknown:]), source.head.frame_rate
    rows = places.reshape(-1) - unknown
    points = np.full((len(rows), 3, len(landmarks)), np.nan)
    for j, name in enumerate(landmarks):
        if name in shapes.landmark_names:
            column = shapes.shapes[:, :, shapes.landmark_names.index(name)]
            points[rows >= 0, :, j] = column[rows[rows >= 0]]
    return Truth(shapes, rows, points, frame_rate)


def renamed_edges(
    edges: NDArray[np.int64] | None, own: Sequence[str], landmarks: Sequence[str]
) -> NDArray[np.int64] | None:
    """Return edges between landmarks `own` as edges between those of the page that it has."""
    if edges is None:
        return None
    place = {name: number for number, name in enumerate(landmarks)}
    ends = [(place.get(own[a], -1), place.get(own[b], -1)) for a, b in edges]
    return np.array([end for end in ends if min(end) >= 0], dtype=np.int64).reshape(-1, 2)


def _keys(match: str, results: Sequence[Gathered], frames: Frames) -> Keys:
    """Return what the frames are matched by; an item is empty where no result says it."""
    if match == BY_FRAME:
        known: dict[str, tuple[str, int]] = {}
        for listing in chain.from_iterable(each.listings for each in results):
            places = zip(*Keys(listing.items, listing.sequences).by_frame(), strict=True)
            known = dict(zip(listing.items, places, strict=True)) | known
        sequences, numbers = zip(*(known[item] for item in frames.items), strict=True)
        for stated in (each.of_frames[FRAME] for each in results if FRAME in each.of_frames):
            numbers = np.where(np.isfinite(stated), stated, numbers).astype(int).tolist()
        return Keys(frames.items, sequences, numbers, results[0].listings[0].frame_rate)
    if match == BY_ITEM:
        return Keys(frames.items)
    named = [each.texts[match] for each in results if match in each.texts]
    if not named:
        found = f"no result has the dataset '{match}'"
        raise input_error("match", found, "name one that holds items of the truth")
    return Keys([next((n[f] for n in named if n[f]), "") for f in range(len(frames.items))])
