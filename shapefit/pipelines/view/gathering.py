"""The numbers of the files and the truth, frame by frame, with the landmarks of all of them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Floats
from shapefit.config import ViewConfig
from shapefit.errors import input_error
from shapefit.io import ShapeSource, open_shapes
from shapefit.io.foreign.items import FRAME
from shapefit.io.listing import AnyRecords, Listing, read_chunks
from shapefit.io.options import input_options
from shapefit.io.records import LandmarkSet, ResultSet, ShapeSet
from shapefit.io.source import open_results
from shapefit.lifting.verdict import DOUBT
from shapefit.pipelines.evaluate.judge import with_shapes_of
from shapefit.pipelines.joints import INPUT_NAMES
from shapefit.pipelines.view.frames import Frames

CAMERA = ("camera_translation", "focal", "principal_point")
"""Datasets that describe how a camera sees the shapes of a result in perspective."""
NUMBERS = ("coefficients", "rotation", "translation", "scale", "relative_gap")
OF_RESULTS = frozenset({"sequence", "landmarks_fitted", "status", "shape_sd", *NUMBERS})
"""Datasets of a result that a page is made of, beside those that the format does not know."""
JUDGEMENTS = ("plausibility", "log_evidence")
"""Datasets (n,) that say how far an image can be trusted: less is worse."""


@dataclass
class Gathered:
    """What one or several files of a name say about the n frames, nan or empty where nothing.

    points (n, 3, p) with the p landmarks of the page; `of_frames` holds other numbers by name, each
    (n, ...), in the orientation of the file; texts the same for texts.
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

    @property
    def attributes(self) -> Mapping[str, Any]:
        """Return the root attributes of the first file."""
        return self.listings[0].attributes


def gather(
    name: str,
    listings: Sequence[Listing],
    index: Mapping[str, int],
    landmarks: Sequence[str],
    match: str,
) -> Gathered:
    """Read the files of one name; `index` maps an item to its frame.

    Raises InputError for an item that two of them have.
    """
    kind = listings[0].kind
    n, p = len(index), len(landmarks)
    gathered = Gathered(name, kind, tuple(listings), np.full((n, 3, p), np.nan))
    taken: dict[int, Any] = {}
    column = {landmark: number for number, landmark in enumerate(landmarks)}
    for listing in listings:
        columns = np.array([column[landmark] for landmark in listing.landmark_names], dtype=np.intp)
        for chunk in read_chunks(listing, OF_RESULTS):
            if isinstance(chunk, ResultSet) and chunk.landmark_names != listing.landmark_names:
                chunk = with_shapes_of(chunk, listing.landmark_names).without(["edges"])
            rows = np.array(
                [r for r, item in enumerate(chunk.items) if item in index], dtype=np.intp
            )
            frames = np.array([index[chunk.items[row]] for row in rows], dtype=np.intp)
            for frame in frames:
                if taken.setdefault(int(frame), listing.path) != listing.path:
                    item = next(item for item, f in index.items() if f == frame)
                    found = f"has the item '{item}', which {taken[int(frame)]} has too"
                    raise input_error(
                        listing.path, found, "give each file a unique name in `files`"
                    )
            _take(gathered, chunk.take(rows), frames, columns, match)
    return gathered


def _take(
    gathered: Gathered,
    records: AnyRecords,
    frames: NDArray[np.intp],
    columns: NDArray[np.intp],
    match: str,
) -> None:
    """Put the records of some frames in their places."""
    n, p = len(gathered.points), gathered.points.shape[2]

    def put(name: str, values: Any) -> None:
        if values is not None:
            values = np.asarray(values, dtype=np.float64)
            whole = gathered.of_frames.setdefault(name, np.full((n, *values.shape[1:]), np.nan))
            whole[frames] = values

    def put_landmarks(name: str, values: Any) -> None:
        """Put values (rows, p, ...) of the file's landmarks under those of the page."""
        if values is None:
            return
        whole = gathered.of_frames.setdefault(name, np.full((n, p, *values.shape[2:]), np.nan))
        whole[np.ix_(frames, columns)] = np.asarray(values, dtype=np.float64)

    if isinstance(records, ShapeSet | ResultSet):
        gathered.points[frames[:, None, None], np.arange(3)[:, None], columns] = records.shapes
    if (
        isinstance(records, ShapeSet)
        and records.mesh_vertices is not None
        and records.mesh_faces is not None
    ):
        gathered.mesh_vertices |= dict(zip(frames.tolist(), records.mesh_vertices, strict=True))
        gathered.mesh_faces = records.mesh_faces
    numbers = records.columns.get(FRAME)
    if numbers is not None and numbers.shape == frames.shape and numbers.dtype.kind in "iuf":
        put(FRAME, numbers)
    if isinstance(records, LandmarkSet):
        put_landmarks("landmarks", _visible(records))
    if isinstance(records, ResultSet):
        _take_result(records, put, put_landmarks)
        of_items = {name: records.columns.get(name) for name in (DOUBT, match)}
        for name, values in {"status": records.status, **of_items}.items():
            if values is not None and np.shape(values) == frames.shape:
                texts = gathered.texts.setdefault(name, np.full(n, "", dtype=object))
                texts[frames] = np.asarray(values).astype(str)
    if records.lines is not None:
        gathered.edges = columns[records.lines]


def _visible(records: LandmarkSet) -> Floats:
    """Landmarks (n, p, 2), nan where hidden or without any confidence."""
    landmarks = records.landmarks.swapaxes(1, 2)
    if records.confidence is None:
        return landmarks
    return np.where((records.confidence > 0)[..., None], landmarks, np.nan)


def _take_result(
    records: ResultSet,
    put: Callable[[str, Any], None],
    put_landmarks: Callable[[str, Any], None],
) -> None:
    extras = records.columns
    put_landmarks("landmarks", extras.get("landmarks"))
    put_landmarks("outliers", extras.get("outliers"))
    if records.shape_sd is not None:
        put_landmarks("shape_sd", records.shape_sd.swapaxes(1, 2))
    if records.landmarks_fitted is not None:
        put_landmarks("landmarks_fitted", records.landmarks_fitted.swapaxes(1, 2))
    for name in NUMBERS:
        put(name, getattr(records, name))
    for name in (*CAMERA, *JUDGEMENTS):
        put(name, extras.get(name))


@dataclass(frozen=True)
class Truth:
    """The true shapes of the frames; rows (n), that of each frame, -1 where there is none.

    points (n, 3, p) with the p landmarks of the page.
    """

    shapes: ShapeSet
    rows: NDArray[np.intp]
    points: Floats


def as_judged(config: ViewConfig, listing: Listing) -> Listing:
    """Return a result with the landmarks that `eval` compares with the truth of the config.

    Those are a detector's landmarks, where more of the truth's names are of these than of joints.
    """
    if not config.truth or listing.kind != "result" or INPUT_NAMES not in listing.datasets:
        return listing
    with open_shapes(config.truth, input_options(config.input), gaps=True) as source:
        names = source.head.landmark_names
    with open_results([listing.path]) as results:
        judged = with_shapes_of(results.head, names)
    return replace(listing, landmark_names=judged.landmark_names)


def read_truth(
    config: ViewConfig, results: Sequence[Gathered], frames: Frames, landmarks: Sequence[str]
) -> Truth:
    """Read the truth of the frames. Raises InputError where there is none of any."""
    keys = _keys(config.match, results, frames)
    with open_shapes(config.truth, input_options(config.input), gaps=True) as source:
        shapes = _named(source, frozenset(keys))
    index = {item: row for row, item in enumerate(shapes.items)}
    rows = np.array([index.get(key, -1) for key in keys], dtype=np.intp)
    if (rows < 0).all():
        found = f"has none of the {len(rows)} items, such as '{keys[0]}'"
        raise input_error("truth", found, "give the truth of these images, or set `match`")
    place = {name: number for number, name in enumerate(landmarks)}
    common = [j for j, name in enumerate(shapes.landmark_names) if name in place]
    columns = [place[shapes.landmark_names[j]] for j in common]
    known = np.flatnonzero(rows >= 0)
    points = np.full((len(rows), 3, len(landmarks)), np.nan)
    points[known[:, None, None], np.arange(3)[:, None], columns] = shapes.shapes[rows[known]][
        :, :, common
    ]
    return Truth(shapes, rows, points)


def _named(source: ShapeSource, items: frozenset[str]) -> ShapeSet:
    """Return the shapes of these items; of the others only the names are read."""
    names = chain.from_iterable(source.names())
    return source.take(np.array([row for row, item in enumerate(names) if item in items], np.intp))


def renamed_edges(
    edges: NDArray[np.int64] | None, own: Sequence[str], landmarks: Sequence[str]
) -> NDArray[np.int64] | None:
    """Return edges between landmarks `own` as edges between those of the page that it has."""
    if edges is None:
        return None
    place = {name: number for number, name in enumerate(landmarks)}
    ends = [(place.get(own[a], -1), place.get(own[b], -1)) for a, b in edges]
    return np.array([end for end in ends if min(end) >= 0], dtype=np.int64).reshape(-1, 2)


def _keys(match: str, results: Sequence[Gathered], frames: Frames) -> Sequence[str]:
    """Item of the truth of each frame, empty where no result says it."""
    if match == "item":
        return frames.items
    named = [each.texts[match] for each in results if match in each.texts]
    if not named:
        found = f"no result has the dataset '{match}'"
        raise input_error("match", found, "name one that holds items of the truth")
    return [next((n[f] for n in named if n[f]), "") for f in range(len(frames.items))]
