"""The metrics: errors of shapes and landmarks, one number per image; and their table.

Functions take whole sets of images and ignore landmarks that are nan on either side. An
image with too few landmarks left has the error nan: it failed.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Flags, Floats, Numbers
from shapefit.geometry.procrustes import centred, similarity_errors
from shapefit.geometry.rotations import rotation_angle

MIN_COMMON_LANDMARKS = 3
"""A similarity or a camera makes any two points coincide, so fewer say nothing."""

IMAGES_MEASURED_AT_ONCE = 1 << 10
"""Their arrays fit into the cache of the processor."""


def similarity_error(estimate: Floats, truth: Floats) -> Floats:
    """Return the mean distance (n,) of landmarks from the truth, once aligned to it.

    By the similarity s, R, t that minimises sum_j |s R e_j + t - x_j|^2. estimate and
    truth (n, 3, p) in any two frames; errors in the unit of the truth. R is proper: a
    mirrored estimate is not forgiven.
    """
    return similarity_errors(estimate, truth, MIN_COMMON_LANDMARKS)


def mean_distance(distances: Floats) -> Floats:
    """Return the mean (n,) of the distances of landmarks (n, p) from the truth.

    nan where fewer than `MIN_COMMON_LANDMARKS` are known.
    """
    return _mean_over_visible(distances, ~np.isnan(distances), MIN_COMMON_LANDMARKS)


def camera_error(estimate: Floats, truth: Floats, rotation: Floats) -> Floats:
    """Return the mean distance (n,) of landmarks from the truth in the camera frame.

    After the scale s >= 0 and shift t that minimise sum_j |s e_j + t - R x_j|^2, but no
    rotation. estimate (n, 3, p) in the camera frame; truth (n, 3, p) in the frame of
    its file and rotation (n, 3, 3) from there to the camera; errors in the unit of the
    truth.
    """
    visible = visible_in_both(estimate, truth)
    x = rotation @ np.where(visible[:, None], truth, 0.0)
    e = centred(estimate, visible)
    x = centred(x, visible)
    overlap = np.maximum((x * e).sum(axis=(1, 2)), 0.0)
    size = np.maximum((e * e).sum(axis=(1, 2)), 0.0)
    scale = np.divide(overlap, size, out=np.zeros_like(size), where=size > 0)
    residual = scale[:, None, None] * e - x
    distance = np.sqrt((residual**2).sum(axis=1))
    return _mean_over_visible(distance, visible, MIN_COMMON_LANDMARKS)


def convert_expected_error(estimate: Floats, truth: Floats, error: Floats) -> Floats:
    """Convert the expected errors `error` (n,) to the unit of the truth.

    error, in the unit of the estimate, times the ratio of the sizes of truth and
    estimate, (n, 3, p) each; nan where the estimate has no size.
    """
    visible = visible_in_both(estimate, truth)
    size = np.sqrt((centred(estimate, visible) ** 2).sum(axis=(1, 2)))
    true_size = np.sqrt((centred(truth, visible) ** 2).sum(axis=(1, 2)))
    ratio = np.full_like(size, np.nan)
    np.divide(true_size, size, out=ratio, where=size > 0)
    scaled: Floats = error * ratio
    return scaled


def reprojection(fitted: Floats, observed: Floats) -> Floats:
    """Return the root mean square reprojection error (n,) of visible landmarks.

    fitted and observed (n, 2, p); nan where none is visible.
    """
    visible = visible_in_both(fitted, observed)
    squares = ((fitted - observed) ** 2).sum(axis=-2)
    return np.sqrt(_mean_over_visible(squares, visible, min_visible=1))


def precision(labelled: Numbers, corrupted: Numbers) -> Floats:
    """Return the share (n,) of landmarks labelled outliers that were corrupted.

    Of each image; nan where none is labelled. Both (n, p), not 0 where they are.
    """
    count = (labelled != 0).sum(axis=-1)
    both = ((labelled != 0) & (corrupted != 0)).sum(axis=-1)
    share: Floats = np.divide(
        both, count, out=np.full(len(count), np.nan), where=count > 0
    )
    return share


def recall(labelled: Numbers, corrupted: Numbers) -> Floats:
    """Return the share (n,) of corrupted landmarks that were labelled outliers.

    Of each image; nan where none is corrupted. Both (n, p), not 0 where they are.
    """
    return precision(corrupted, labelled)


def box_diagonal(observed: Floats, boxes: Floats | None = None) -> Floats:
    """Return the diagonal (n,) of the box around the landmarks of each image.

    Boxes are x y w h; without them, those around visible landmarks (n, 2, p) count. nan
    where none is visible, or all are on one point: such a box measures nothing.
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
    """Return the standard deviation of the true landmarks that are on both sides.

    An error over it is normalised. (n, 3, p) each -> (n,), in the frame of the truth
    file; nan where the true landmarks lie on one point, which leaves no scale.
    """
    visible = visible_in_both(estimate, truth)
    x = centred(truth, visible)
    size = np.abs(np.where(visible[:, None], truth, 0.0)).max(axis=(1, 2), initial=0.0)
    extent = np.ptp(x, axis=-1).max(axis=-1, initial=0.0)
    is_extended = extent > 4 * np.finfo(float).eps * size
    count = visible.sum(axis=-1)[:, None]
    with np.errstate(invalid="ignore"):  # where no landmark is on both sides
        variance = (x**2).sum(axis=-1) / count
        scale = np.sqrt(variance).mean(axis=-1)
    return np.where(is_extended, scale, np.nan)


def visible_in_both(first: Floats, second: Floats) -> Flags:
    """Return which landmarks (n, p) are finite in both arrays (n, d, p)."""
    visible: Flags = np.all(np.isfinite(first) & np.isfinite(second), axis=-2)
    return visible


def _mean_over_visible(values: Floats, visible: Flags, min_visible: int) -> Floats:
    """Return the mean (n,) over visible values (n, p), nan where these are too few."""
    count = visible.sum(axis=-1)
    total = np.where(visible, values, 0.0).sum(axis=-1)
    mean = np.full(len(values), np.nan)
    np.divide(total, count, out=mean, where=count >= min_visible)
    return mean


def in_blocks(measure: Callable[..., Any], *arrays: NDArray[Any] | None) -> Any:
    """Return measure(*arrays), computed block by block to save memory.

    measure returns an array (n, ...) or a tuple of them; arrays have n rows or are
    None.
    """
    count = next(len(array) for array in arrays if array is not None)
    parts = []
    for start in range(0, count, IMAGES_MEASURED_AT_ONCE):
        rows = slice(start, start + IMAGES_MEASURED_AT_ONCE)
        block = [None if array is None else array[rows] for array in arrays]
        parts.append(measure(*block))
    if isinstance(parts[0], tuple):
        return tuple(map(np.concatenate, zip(*parts, strict=True)))
    return np.concatenate(parts)


LENGTH = "length"
"""Of metrics in the unit of the truth, and normalised by the true shape."""

IMAGE_LENGTH = "image"
"""Of metrics in the unit of the landmarks, and as a share of the box."""

SHARE = "share"
"""Of metrics that are a share of landmarks."""

CARRIED: dict[str, tuple[int | Literal["p"], ...]] = {
    "landmarks": ("p", 2),
    "bounding_box": (4,),
    "true_rotation": (3, 3),
    "shape_correlation": ("p", 3),
    "expected_error": (),
    "outliers": ("p",),
    "corrupted": ("p",),
}
"""Datasets that results carry for metrics -> their shape within one image."""


class Metric(NamedTuple):
    """A number for each image: how far its estimate is from the truth.

    function takes the datasets `needs` in their order (`estimate` and `truth` are the
    shapes, `aligned_distances` those of landmarks after the best similarity) and
    returns (n,), nan where an image cannot be measured; unit is LENGTH, IMAGE_LENGTH,
    SHARE or deg; title is that of a figure. Where `optional`, an image may have no such
    error and has not failed.
    """

    function: Callable[..., Floats]
    needs: tuple[str, ...]
    unit: str
    title: str
    optional: bool = False


METRICS = {
    "similarity": Metric(
        mean_distance,
        needs=("aligned_distances",),
        unit=LENGTH,
        title="3D error up to a similarity",
    ),
    "camera": Metric(
        camera_error,
        needs=("estimate", "truth", "true_rotation"),
        unit=LENGTH,
        title="3D error in the camera frame",
    ),
    "rotation": Metric(
        rotation_angle,
        needs=("true_rotation", "rotation"),
        unit="deg",
        title="Angle to the true rotation",
    ),
    "reprojection": Metric(
        reprojection,
        needs=("landmarks_fitted", "landmarks"),
        unit=IMAGE_LENGTH,
        title="RMS reprojection error",
    ),
    "expected": Metric(
        convert_expected_error,
        needs=("estimate", "truth", "expected_error"),
        unit=LENGTH,
        title="Expected 3D error up to a similarity",
        optional=True,
    ),
    "precision": Metric(
        precision,
        needs=("outliers", "corrupted"),
        unit=SHARE,
        title="Precision of the outlier labels",
        optional=True,
    ),
    "recall": Metric(
        recall,
        needs=("outliers", "corrupted"),
        unit=SHARE,
        title="Recall of the outlier labels",
        optional=True,
    ),
}
"""The metrics by name. A new one is a function and a row."""
