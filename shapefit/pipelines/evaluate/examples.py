"""The images that a report shows, and the shape on which it shows errors."""

from __future__ import annotations

from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np

from shapefit.arrays import Floats, Indices, Integers, evenly
from shapefit.evaluation.figures import Example, TypicalShape
from shapefit.geometry.cameras import TO_Y_UP
from shapefit.geometry.normalisation import normalise
from shapefit.geometry.procrustes import (
    generalised_procrustes,
    similarity_transform,
)
from shapefit.io.skeletons import edges_of
from shapefit.pipelines.evaluate.measure import MatchedResults, find_dataset
from shapefit.records import Shapes

WORDS = ("best", "median", "worst")
"""Rows of examples."""

INSPECTED_SHAPES = 200
"""Of which the typical one is chosen."""

ITEM_LETTERS = 22
"""Last letters of an item that stand above it."""

MIN_DISTANCE_SHARE = 0.05
"""Share of all images by which two examples are apart in the file, at least."""

AXES_UP: tuple[Literal["x", "y", "z"], ...] = ("x", "y", "z")
AXES_DOWN: tuple[Literal["-x", "-y", "-z"], ...] = ("-x", "-y", "-z")
"""Names of directions."""

MIN_UP = 0.3
"""Length of the mean direction that is up in images from which on it is believed."""


class MethodExamples(NamedTuple):
    """What a report draws of one method beside its numbers.

    examples: a row for the best, the median and the worst images, in the unit that
    people read; typical: the shape on which errors of landmarks are shown; edges (e, 2)
    between landmarks.
    """

    method: str
    examples: tuple[tuple[Example, ...], ...]
    typical: TypicalShape
    edges: Integers


def choose_examples(
    method: str,
    matched: MatchedResults,
    truth: Shapes,
    error: Floats,
    unit: str,
) -> MethodExamples | None:
    """Choose the example images and the typical shape that a report draws of a method.

    error (n,) in `unit`, as people read it; None where no image has any.
    """
    rows = _choose_rows(error)
    if not rows:
        return None
    edges = _find_edges(matched, truth)
    examples = []
    for word, chosen in zip(WORDS, rows, strict=True):
        of_row = []
        for row in chosen:
            item = matched.results.items[row]
            short = item if len(item) <= ITEM_LETTERS else f"…{item[-ITEM_LETTERS:]}"
            title = f"{word}: {short}, {_format_error(error[row])} {unit}"
            of_row.append(_make_example(matched, truth, row, title))
        examples.append(tuple(of_row))
    return MethodExamples(
        method, tuple(examples), _find_typical_shape(matched, truth, edges), edges
    )


def _format_error(error: float) -> str:
    """Return an error as text with three digits, and as an integer from 100 on."""
    return f"{error:,.0f}" if error >= 100 else f"{error:.3g}"


def _choose_rows(error: Floats) -> list[list[int]]:
    """Return the rows of the best, median and worst images, two of each.

    Errors (n,); [] where none is finite.
    """
    order = np.argsort(np.where(np.isfinite(error), error, np.inf), kind="stable")
    order = order[: np.isfinite(error).sum()]
    if not len(order):
        return []
    from_middle = order[len(order) // 2 :]
    return [_first_and_another(ranked) for ranked in (order, from_middle, order[::-1])]


def _first_and_another(ranked: Indices) -> list[int]:
    """Return the first of ranked rows, and the next that is not near it in the file.

    Neighbours in a video look the same.
    """
    first = int(ranked[0])
    is_apart = np.abs(ranked - first) > len(ranked) * MIN_DISTANCE_SHARE
    others = ranked[is_apart] if is_apart.any() else ranked[1:]
    return [first, int(others[0])] if len(others) else [first]


def _find_edges(matched: MatchedResults, truth: Shapes) -> Integers:
    """Return the edges (e, 2) between common landmarks, as indices of these.

    They are those of the truth, else of the results, else of a skeleton with such
    names.
    """
    column = {name: place for place, name in enumerate(matched.names)}
    for record in (truth, matched.results):
        if record.edges is None:
            continue
        names = record.landmark_names
        ends = [
            (column[names[a]], column[names[b]])
            for a, b in record.edges.tolist()
            if names[a] in column and names[b] in column
        ]
        if ends:
            return np.array(ends, dtype=np.int64)
    return np.array(edges_of(matched.names), dtype=np.int64).reshape(-1, 2)


def _make_example(
    matched: MatchedResults, truth: Shapes, row: int, title: str
) -> Example:
    """Return the Example of an image: its estimate, and its truth turned onto that.

    Both are in the scale of the truth, about the middle of their common landmarks.
    """
    to_viewer = _turn_to_viewer(matched)
    estimate = matched.estimate[row]
    true = matched.true[row]
    is_common = np.isfinite(estimate + true).all(axis=0)
    e = estimate[:, is_common]
    x = true[:, is_common]
    turn = similarity_transform(x, e).rotation
    scale = similarity_transform(e, x).scale
    middle = x.mean(axis=1, keepdims=True)
    observed = find_dataset(Path(), matched.results, "landmarks")
    seen = None
    if observed is not None:
        seen = to_viewer[:2, :2] @ observed[row].take(matched.columns, axis=1)
        if not np.isfinite(seen).all(axis=0).any():
            seen = None
    return Example(
        title,
        seen,
        to_viewer @ turn @ (true - middle),
        to_viewer @ (scale * (estimate - e.mean(axis=1, keepdims=True))),
        _turn_true_mesh(matched, truth, row, to_viewer @ turn, middle),
    )


def _turn_true_mesh(
    matched: MatchedResults, truth: Shapes, row: int, turn: Floats, middle: Floats
) -> Floats | None:
    """Return the true mesh of an image as triangles (f, 3, 3), turned about a point.

    turn (3, 3), middle (3, 1); None where the truth has no meshes.
    """
    if truth.mesh_vertices is None or truth.mesh_faces is None:
        return None
    vertices = truth.mesh_vertices[matched.rows[row]].T
    triangles: Floats = (turn @ (vertices - middle)).T[truth.mesh_faces]
    return triangles


def _turn_to_viewer(matched: MatchedResults) -> Floats:
    """Return the rotation (3, 3) of camera axes to x right, y up, z to the viewer.

    Without landmarks shapes of other tools are upright as they are.
    """
    is_up = matched.results.y_axis == "up"
    if matched.results.y_axis is None and matched.results.landmarks is None:
        is_up = True
    return np.eye(3) if is_up else np.diag([1.0, -1.0, -1.0])


def _find_typical_shape(
    matched: MatchedResults, truth: Shapes, edges: Integers
) -> TypicalShape:
    """Return the true shape next to the mean of all, upright, at its broad side."""
    some = evenly(len(matched.true), INSPECTED_SHAPES)
    known = np.isfinite(matched.true[some]).all(axis=1)
    complete = some[known.sum(axis=1) == known.sum(axis=1).max()]
    row = _find_most_usual(matched.true, complete)
    shape = matched.true[row]
    middle = np.nanmean(shape, axis=1, keepdims=True)
    upright = _turn_upright(matched, complete)
    turn = _turn_broad_side(upright @ (shape - middle)) @ upright
    mesh = _turn_true_mesh(matched, truth, row, turn, middle)
    return TypicalShape(turn @ (shape - middle), edges, mesh)


def _find_most_usual(true: Floats, rows: Indices) -> int:
    """Return the one of `rows` whose shape (n, 3, p) is nearest to the mean of them."""
    shapes = true[rows]
    if not np.isfinite(shapes).all():
        return int(rows[0])
    normalised = normalise(shapes).points
    if not np.isfinite(normalised).all():
        return int(rows[0])
    alignment = generalised_procrustes(normalised)
    off = ((alignment.shapes - alignment.mean) ** 2).sum(axis=(1, 2))
    return int(rows[off.argmin()])


def _turn_upright(matched: MatchedResults, rows: Indices) -> Floats:
    """Return the rotation (3, 3) of the frame of the truth after which y is up.

    Cameras are mostly upright: the axis of the truth that most often points up in the
    images is up. Without one, y is.
    """
    up_in_camera = _turn_to_viewer(matched)[1]
    estimate = matched.estimate[rows]
    true = matched.true[rows]
    is_whole = np.isfinite(estimate + true).all(axis=(1, 2))
    if not is_whole.any():
        return np.eye(3)
    turns = similarity_transform(true[is_whole], estimate[is_whole]).rotation
    up = (np.swapaxes(turns, 1, 2) @ up_in_camera).mean(axis=0)
    axis = int(np.abs(up).argmax())
    if not abs(up[axis]) > MIN_UP:
        return np.eye(3)
    return TO_Y_UP[AXES_DOWN[axis] if up[axis] < 0 else AXES_UP[axis]]


def _turn_broad_side(shape: Floats) -> Floats:
    """Return the rotation (3, 3) about y by which a shape's broad side is in front."""
    across = shape[[0, 2]][:, np.isfinite(shape).all(axis=0)]
    values, axes = np.linalg.eigh(across @ across.T)
    x, z = axes[:, values.argmax()]
    # the smaller turn of the two
    x, z = (x, z) if x >= 0 else (-x, -z)
    return np.array([[x, 0.0, z], [0.0, 1.0, 0.0], [-z, 0.0, x]])
