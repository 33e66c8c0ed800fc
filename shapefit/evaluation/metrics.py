"""The metrics: errors of estimated shapes and landmarks, one number per image; and
their table.

Functions take whole sets of images and ignore landmarks that are nan on either side. An
image with too few landmarks left has the error nan: it failed.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Flags, Floats
from shapefit.geometry.procrustes import centred, similarity_errors
from shapefit.geometry.rotations import rotation_angle

FEWEST_LANDMARKS = 3
"""A similarity or a camera makes any two points coincide, so fewer say nothing."""
BLOCK = 1 << 10
"""Images that are measured together: their arrays fit into the cache of the processor.
"""


def similarity(estimate: Floats, truth: Floats) -> Floats:
    """min over s, R, t of sum_j |s R e_j + t - x_j|^2; then the mean over j of that
    distance.

    estimate and truth (n, 3, p) in any two frames -> (n,), in the unit of the truth. R
    is proper: a mirrored estimate is not forgiven.
    """
    return similarity_errors(estimate, truth, FEWEST_LANDMARKS)


def camera(estimate: Floats, truth: Floats, rotation: Floats) -> Floats:
    """min over s >= 0, t of sum_j |s e_j + t - R x_j|^2; then the mean over j of that
    distance.

    estimate (n, 3, p) in the camera frame; truth (n, 3, p) in the frame of its file and
    rotation (n, 3, 3) from there to the camera -> (n,), in the unit of the truth.
    """
    visible = visible_in_both(estimate, truth)
    x = rotation @ np.where(visible[:, None], truth, 0.0)
    e, x = centred(estimate, visible), centred(x, visible)
    overlap, size = (
        np.maximum((points * e).sum(axis=(1, 2)), 0.0) for points in (x, e)
    )
    scale = np.divide(overlap, size, out=np.zeros_like(size), where=size > 0)
    distance = np.sqrt(((scale[:, None, None] * e - x) ** 2).sum(axis=1))
    return _mean_over_visible(distance, visible, FEWEST_LANDMARKS)


def expected(estimate: Floats, truth: Floats, error: Floats) -> Floats:
    """Errors (n,) that results expect after a similarity, in the unit of the truth.

    By the ratio of the sizes of truth and estimate, (n, 3, p) each.
    """
    visible = visible_in_both(estimate, truth)
    e, x = (
        np.sqrt((centred(points, visible) ** 2).sum(axis=(1, 2)))
        for points in (estimate, truth)
    )
    scaled: Floats = error * np.divide(x, e, out=np.full_like(e, np.nan), where=e > 0)
    return scaled


def reprojection(fitted: Floats, observed: Floats) -> Floats:
    """sqrt(mean over the visible landmarks j of |w_j - v_j|^2); (n, 2, p) each ->
    (n,).
    """
    visible = visible_in_both(fitted, observed)
    squares = ((fitted - observed) ** 2).sum(axis=-2)
    return np.sqrt(_mean_over_visible(squares, visible, fewest=1))


def precision(labelled: NDArray[Any], corrupted: NDArray[Any]) -> Floats:
    """|labelled and corrupted| / |labelled| of each image (n,); nan where nothing is
    labelled.
    """
    count = (labelled != 0).sum(axis=-1)
    both = ((labelled != 0) & (corrupted != 0)).sum(axis=-1)
    share: Floats = np.divide(
        both, count, out=np.full(len(count), np.nan), where=count > 0
    )
    return share


def recall(labelled: NDArray[Any], corrupted: NDArray[Any]) -> Floats:
    """|labelled and corrupted| / |corrupted| of each image (n,); nan where nothing is
    corrupted.
    """
    return precision(corrupted, labelled)


def box_diagonal(observed: Floats, boxes: Floats | None = None) -> Floats:
    """Diagonal (n,) of the boxes (n, 4), x y w h, else of those around visible
    landmarks (n, 2, p).

    nan where none is visible, or all are on one point: such a box measures nothing.
    """
    if boxes is not None:
        sides = boxes[:, 2:].T
    else:
        visible = visible_in_both(observed, observed)[:, None]
        lowest = np.where(visible, observed, np.inf).min(axis=-1)
        highest = np.where(visible, observed, -np.inf).max(axis=-1)
        sides = np.maximum(highest - lowest, 0.0).T
    diagonal = np.hypot(*sides)
    return np.where(diagonal > 0, diagonal, np.nan)


def truth_scale(estimate: Floats, truth: Floats) -> Floats:
    """Standard deviation of the true landmarks on both sides: error / scale is
    normalised.

    (n, 3, p) each -> (n,), in the frame of the truth file; nan where the true landmarks
    lie on one point, which leaves no scale.
    """
    visible = visible_in_both(estimate, truth)
    x = centred(truth, visible)
    size = np.abs(np.where(visible[:, None], truth, 0.0)).max(axis=(1, 2), initial=0.0)
    extended = (
        np.ptp(x, axis=-1).max(axis=-1, initial=0.0) > 4 * np.finfo(float).eps * size
    )
    with np.errstate(invalid="ignore"):  # where no landmark is on both sides
        scale = np.sqrt((x**2).sum(axis=-1) / visible.sum(axis=-1)[:, None]).mean(
            axis=-1
        )
    return np.where(extended, scale, np.nan)


def visible_in_both(first: Floats, second: Floats) -> Flags:
    """Landmarks with finite coordinates on both sides; (n, d, p) each -> (n, p)."""
    visible: Flags = np.all(np.isfinite(first) & np.isfinite(second), axis=-2)
    return visible


def _mean_over_visible(values: Floats, visible: Flags, fewest: int) -> Floats:
    """Mean of the visible of values (n, p) -> (n,); nan with less than the fewest
    visible.
    """
    count = visible.sum(axis=-1)
    total = np.where(visible, values, 0.0).sum(axis=-1)
    mean: Floats = np.divide(
        total, count, out=np.full(len(values), np.nan), where=count >= fewest
    )
    return mean


def in_blocks(measure: Callable[..., Any], *arrays: NDArray[Any] | None) -> Any:
    """Return measure(*arrays), an array (n, ...) or a tuple of them, in blocks of n
    images.
    """
    count = next(len(array) for array in arrays if array is not None)
    parts = [
        measure(
            *(None if array is None else array[row : row + BLOCK] for array in arrays)
        )
        for row in range(0, count, BLOCK)
    ]
    if isinstance(parts[0], tuple):
        return tuple(map(np.concatenate, zip(*parts, strict=True)))
    return np.concatenate(parts)


LENGTH, IMAGE, SHARE = "length", "image", "share"
"""Units of metrics: that of the truth, and normalised by the true shape; that of the
landmarks, and as a share of the box; a share of landmarks.
"""

CARRIED: dict[str, tuple[int | Literal["p"], ...]] = {
    "landmarks": ("p", 2),
    "bounding_box": (4,),
    "true_rotation": (3, 3),
    "shape_correlation": ("p", 3),
    "expected_error": (),
    "outliers": ("p",),
    "corrupted": ("p",),
}
"""Datasets that results carry for metrics -> their shape within one image, p landmarks
a row.
"""


class Metric(NamedTuple):
    """A number for each image: how far its estimate is from the truth.

    function takes the datasets `needs` in their order (`estimate` and `truth` are the
    shapes) and returns (n,), nan where an image cannot be measured; unit is LENGTH,
    IMAGE, SHARE or deg; title is that of a plot. Where `optional`, an image may have no
    such error and has not failed.
    """

    function: Callable[..., Floats]
    needs: tuple[str, ...]
    unit: str
    title: str
    optional: bool = False


_SHAPES, _LABELS = ("estimate", "truth"), ("outliers", "corrupted")
METRICS = {
    "similarity": Metric(similarity, _SHAPES, LENGTH, "3D error up to a similarity"),
    "camera": Metric(
        camera, (*_SHAPES, "true_rotation"), LENGTH, "3D error in the camera frame"
    ),
    "rotation": Metric(
        rotation_angle,
        ("true_rotation", "rotation"),
        "deg",
        "Angle to the true rotation",
    ),
    "reprojection": Metric(
        reprojection, ("landmarks_fitted", "landmarks"), IMAGE, "RMS reprojection error"
    ),
    "expected": Metric(
        expected,
        (*_SHAPES, "expected_error"),
        LENGTH,
        "Expected 3D error up to a similarity",
        True,
    ),
    "precision": Metric(
        precision, _LABELS, SHARE, "Precision of the outlier labels", True
    ),
    "recall": Metric(recall, _LABELS, SHARE, "Recall of the outlier labels", True),
}
"""The metrics by name. A new one is a function and a row."""
