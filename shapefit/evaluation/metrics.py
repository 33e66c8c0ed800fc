"""The metrics: errors of estimated shapes and landmarks, one number per image; and their table.

Functions take whole sets of images and ignore landmarks that are nan on either side. An image with
too few landmarks left has the error nan: it failed.
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
"""Images that are measured together: their arrays fit into the cache of the processor."""


def similarity(estimate: Floats, truth: Floats) -> Floats:
    """min over s, R, t of sum_j |s R e_j + t - x_j|^2; then the mean over j of that distance.

    estimate and truth (n, 3, p) in any two frames -> (n,), in the unit of the truth. R is proper:
    a mirrored estimate is not forgiven.
    """
    return similarity_errors(estimate, truth, FEWEST_LANDMARKS)


def camera(estimate: Floats, truth: Floats, rotation: Floats) -> Floats:
    """min over s >= 0, t of sum_j |s e_j + t - R x_j|^2; then the mean over j of that distance.

    estimate (n, 3, p) in the camera frame; truth (n, 3, p) in the frame of its file and rotation
    (n, 3, 3) from there to the camera -> (n,), in the unit of the truth.
    """
    visible = visible_in_both(estimate, truth)
    x = rotation @ np.where(visible[:, None], truth, 0.0)
    e, x = centred(estimate, visible), centred(x, visible)
    overlap, size = (np.maximum((points * e).sum(axis=(1, 2)), 0.0) for points in (x, e))
    scale = np.divide(overlap, size, out=np.zeros_like(size), where=size > 0)
    distance = np.sqrt(((scale[:, None, None] * e - x) ** 2).sum(axis=1))
    return _mean_over_visible(distance, visible, FEWEST_LANDMARKS)


def expected(estimate: Floats, truth: Floats, error: Floats) -> Floats:
    """Errors (n,) that results expect after a similarity, in the unit of the truth.

    By the ratio of the sizes of truth and estimate, (n, 3, p) each.
    """
    visible = visible_in_both(estimate, truth)
    e, x = (
        np.sqrt((centred(points, visible) ** 2).sum(axis=(1, 2))) for points in (estimate, truth)
    )
    return error * np.divide(x, e, out=np.full_like(e, np.nan), where=e > 0)


def reprojection(fitted: Floats, observed: Floats) -> Floats:
    """sqrt(mean over the visible landmarks j of |w_j - v_j|^2); (n, 2, p) each -> (n,)."""
    visible = visible_in_both(fitted, observed)
    squares = ((fitted - observed) ** 2).sum(axis=-2)
    return np.sqrt(_mean_over_visible(squares, visible, fewest=1))


def precision(labelled: Flags, corrupted: Flags) -> Floats:
    """|labelled and corrupted| / |labelled| of each image (n,); nan where nothing is labelled."""
    count = labelled.sum(axis=-1)
    nothing = np.full(len(count), np.nan)
    return np.divide((labelled & corrupted).sum(axis=-1), count, out=nothing, where=count > 0)


def recall(labelled: Flags, corrupted: Flags) -> Floats:
    """|labelled and corrupted| / |corrupted| of each image (n,); nan where nothing is corrupted."""
    return precision(corrupted, labelled)


def box_diagonal(observed: Floats, boxes: Floats | None = None) -> Floats:
    """Diagonal (n,) of the boxes (n, 4), x y w h, else of those around visible landmarks (n, 2, p).

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
    """Standard deviation of the true landmarks on both sides: error / scale is normalised.

    (n, 3, p) each -> (n,); nan where the true landmarks lie on one point, which leaves no scale.
    It is taken in the frame of the truth file, for `similarity` and `camera` alike.
    """
    visible = visible_in_both(estimate, truth)
    x = centred(truth, visible)
    size = np.abs(np.where(visible[:, None], truth, 0.0)).max(axis=(1, 2), initial=0.0)
    extended = np.ptp(x, axis=-1).max(axis=-1, initial=0.0) > 4 * np.finfo(float).eps * size
    with np.errstate(invalid="ignore"):  # where no landmark is judged
        scale = np.sqrt((x**2).sum(axis=-1) / visible.sum(axis=-1)[:, None]).mean(axis=-1)
    return np.where(extended, scale, np.nan)


def visible_in_both(first: Floats, second: Floats) -> Flags:
    """Landmarks with finite coordinates on both sides; (n, d, p) each -> (n, p)."""
    visible: Flags = np.all(np.isfinite(first) & np.isfinite(second), axis=-2)
    return visible


def _mean_over_visible(values: Floats, visible: Flags, fewest: int) -> Floats:
    """Mean of the visible of values (n, p) -> (n,); nan with less than the fewest visible."""
    count = visible.sum(axis=-1)
    total = np.where(visible, values, 0.0).sum(axis=-1)
    return np.divide(total, count, out=np.full(len(values), np.nan), where=count >= fewest)


def in_blocks(measure: Callable[..., Any], *arrays: NDArray[Any] | None) -> Any:
    """Return measure(*arrays), an array (n, ...) or a tuple of them, in blocks of n images."""
    count = next(len(array) for array in arrays if array is not None)
    parts = [
        measure(*(None if array is None else array[row : row + BLOCK] for array in arrays))
        for row in range(0, count, BLOCK)
    ]
    if isinstance(parts[0], tuple):
        return tuple(map(np.concatenate, zip(*parts, strict=True)))
    return np.concatenate(parts)


LENGTH, IMAGE, SHARE = "length", "image", "share"
"""Units of metrics: that of the truth, and normalised by the true shape; that of the landmarks, and
as a share of the box; a share of landmarks."""


class Dataset(NamedTuple):
    """A dataset that a metric takes: its name, and its shape within one image in the file.

    `p` stands for the number of landmarks. Points ("p", d) come one per row in the file and one per
    column to the metric; `labels` are booleans.
    """

    name: str
    shape: tuple[int | Literal["p"], ...] = ()
    labels: bool = False


ESTIMATE, TRUTH = Dataset("estimate", ("p", 3)), Dataset("truth", ("p", 3))
"""The shapes that are compared, with the landmarks of both: every evaluation has them."""
LANDMARKS, FITTED = Dataset("landmarks", ("p", 2)), Dataset("landmarks_fitted", ("p", 2))
BOX = Dataset("bounding_box", (4,))
ROTATION, TRUE_ROTATION = Dataset("rotation", (3, 3)), Dataset("true_rotation", (3, 3))
DEVIATION, CORRELATION = Dataset("shape_sd", ("p", 3)), Dataset("shape_correlation", ("p", 3))
EXPECTED = Dataset("expected_error")
OUTLIERS = Dataset("outliers", ("p",), labels=True)
CORRUPTED = Dataset("corrupted", ("p",), labels=True)


class Metric(NamedTuple):
    """A number for each image: how far its estimate is from the truth.

    function takes the arrays of `needs` in their order and returns (n,), nan where an image cannot
    be measured; unit is LENGTH, IMAGE, or a unit such as deg; title is that of a plot. A metric
    `of_labels` must be asked for by name. Where one is `optional`, its datasets may be absent
    without a warning; for both nan is no failure.
    """

    function: Callable[..., Floats]
    needs: tuple[Dataset, ...]
    unit: str
    title: str
    of_labels: bool = False
    optional: bool = False

    @property
    def may_lack(self) -> bool:
        """Whether nan is no failure of the image."""
        return self.of_labels or self.optional


METRICS = {
    "similarity": Metric(similarity, (ESTIMATE, TRUTH), LENGTH, "3D error up to a similarity"),
    "camera": Metric(
        camera, (ESTIMATE, TRUTH, TRUE_ROTATION), LENGTH, "3D error in the camera frame"
    ),
    "rotation": Metric(
        rotation_angle, (TRUE_ROTATION, ROTATION), "deg", "Angle to the true rotation"
    ),
    "reprojection": Metric(reprojection, (FITTED, LANDMARKS), IMAGE, "RMS reprojection error"),
    "expected": Metric(
        expected, (ESTIMATE, TRUTH, EXPECTED), LENGTH, "Expected 3D error up to a similarity",
        optional=True,
    ),
    "precision": Metric(
        precision, (OUTLIERS, CORRUPTED), SHARE, "Precision of the outlier labels", of_labels=True
    ),
    "recall": Metric(
        recall, (OUTLIERS, CORRUPTED), SHARE, "Recall of the outlier labels", of_labels=True
    ),
}  # fmt: skip
"""The metrics by name. A new one is a function and a row."""
