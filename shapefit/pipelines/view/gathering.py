"""The numbers of the files, frame by frame and with the landmarks of all of them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Floats
from shapefit.errors import input_error
from shapefit.io.kinds.listing import AnyRecords, Listing, read_chunks
from shapefit.io.records import LandmarkSet, ResultSet, ShapeSet
from shapefit.lifting.verdict import DOUBT

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

    def put_landmarks(name: str, values: Any, expected: tuple[int, ...]) -> None:
        """Put values (rows, p, ...) of the file's landmarks under those of the page."""
        if values is None or values.shape[1:] != (len(columns), *expected):
            return
        whole = gathered.of_frames.setdefault(name, np.full((n, p, *expected), np.nan))
        whole[np.ix_(frames, columns)] = np.asarray(values, dtype=np.float64)

    if isinstance(records, ShapeSet | ResultSet):
        gathered.points[frames[:, None, None], np.arange(3)[:, None], columns] = records.shapes
    if isinstance(records, ShapeSet):
        if records.edges is not None:
            gathered.edges = columns[records.edges]
        if records.mesh_vertices is not None and records.mesh_faces is not None:
            gathered.mesh_vertices |= dict(zip(frames.tolist(), records.mesh_vertices, strict=True))
            gathered.mesh_faces = records.mesh_faces
    if isinstance(records, LandmarkSet):
        put_landmarks("landmarks", _visible(records), (2,))
    if isinstance(records, ResultSet):
        _take_result(records, put, put_landmarks)
        of_items = {name: records.extras.get(name) for name in (DOUBT, match)}
        for name, values in {"status": records.status, **of_items}.items():
            if values is not None and np.ndim(values) == 1:  # one per item
                texts = gathered.texts.setdefault(name, np.full(n, "", dtype=object))
                texts[frames] = np.asarray(values).astype(str)
    edges = records.extras.get("edges")
    if edges is not None and edges.ndim == 2 and edges.shape[1] == 2 and edges.dtype.kind in "iu":
        inside = (edges >= 0).all() and (edges < len(columns)).all()
        gathered.edges = columns[edges] if inside else gathered.edges


def _visible(records: LandmarkSet) -> Floats:
    """Landmarks (n, p, 2), nan where hidden or without any confidence."""
    landmarks = records.landmarks.swapaxes(1, 2)
    if records.confidence is None:
        return landmarks
    return np.where((records.confidence > 0)[..., None], landmarks, np.nan)


def _take_result(
    records: ResultSet,
    put: Callable[[str, Any], None],
    put_landmarks: Callable[[str, Any, tuple[int, ...]], None],
) -> None:
    extras = records.extras
    put_landmarks("landmarks", extras.get("landmarks"), (2,))
    put_landmarks("outliers", extras.get("outliers"), ())
    if records.shape_sd is not None:
        put_landmarks("shape_sd", records.shape_sd.swapaxes(1, 2), (3,))
    if records.landmarks_fitted is not None:
        put_landmarks("landmarks_fitted", records.landmarks_fitted.swapaxes(1, 2), (2,))
    for name in NUMBERS:
        put(name, getattr(records, name))
    for name in (*CAMERA, *JUDGEMENTS):
        values = extras.get(name)
        if values is not None and values.dtype.kind in "biuf":
            put(name, values)
