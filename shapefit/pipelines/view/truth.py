"""The true shapes of the frames of a page, with the landmarks of the page."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Floats
from shapefit.config import ViewConfig
from shapefit.errors import input_error
from shapefit.io import ShapeSet, ShapeSource, open_shapes
from shapefit.pipelines.reading import input_options
from shapefit.pipelines.view.frames import Frames
from shapefit.pipelines.view.gathering import Gathered


@dataclass(frozen=True)
class Truth:
    """The true shapes of the frames; rows (n), that of each frame, -1 where there is none.

    points (n, 3, p) with the p landmarks of the page.
    """

    shapes: ShapeSet
    rows: NDArray[np.intp]
    points: Floats


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
