"""Errors of estimated shapes and landmarks, one number per image.

All functions take whole sets of images, and leave out, image by image, the landmarks that are nan
on either side. An image with too few landmarks left has the error nan: it failed.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Flags, Floats
from shapefit.geometry.procrustes import similarity_errors

FEWEST_LANDMARKS = 3
"""A similarity or a camera makes any two points coincide, so fewer say nothing."""


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
    seen = visible_in_both(estimate, truth)
    x = rotation @ np.where(seen[:, None], truth, 0.0)
    e, x = _centred(estimate, seen), _centred(x, seen)
    overlap, size = (np.maximum((points * e).sum(axis=(1, 2)), 0.0) for points in (x, e))
    scale = np.divide(overlap, size, out=np.zeros_like(size), where=size > 0)
    distance = np.sqrt(((scale[:, None, None] * e - x) ** 2).sum(axis=1))
    return _mean_over_visible(distance, seen, FEWEST_LANDMARKS)


def expected(estimate: Floats, truth: Floats, error: Floats) -> Floats:
    """Errors (n,) that results expect after a similarity, in the unit of the truth.

    By the ratio of the sizes of truth and estimate, (n, 3, p) each.
    """
    seen = visible_in_both(estimate, truth)
    e, x = (np.sqrt((_centred(points, seen) ** 2).sum(axis=(1, 2))) for points in (estimate, truth))
    return error * np.divide(x, e, out=np.full_like(e, np.nan), where=e > 0)


def reprojection(fitted: Floats, observed: Floats) -> Floats:
    """sqrt(mean over the visible landmarks j of |w_j - v_j|^2); (n, 2, p) each -> (n,)."""
    visible = visible_in_both(fitted, observed)
    squares = ((fitted - observed) ** 2).sum(axis=-2)
    return np.sqrt(_mean_over_visible(squares, visible, fewest=1))


def box_diagonal(observed: Floats) -> Floats:
    """Diagonal of the upright box around the visible landmarks; (n, 2, p) -> (n,).

    nan where none is visible, or all are on one point: such a box measures nothing.
    """
    visible = visible_in_both(observed, observed)[:, None, :]
    lowest = np.where(visible, observed, np.inf).min(axis=-1)
    highest = np.where(visible, observed, -np.inf).max(axis=-1)
    diagonal = np.hypot(*np.maximum(highest - lowest, 0.0).T)
    return np.where(diagonal > 0, diagonal, np.nan)


def truth_scale(estimate: Floats, truth: Floats) -> Floats:
    """Spread of the true landmarks that are judged: error / scale is the normalised error.

    (n, 3, p) each -> (n,); nan where the true landmarks lie on one point, which leaves no scale.
    The spread is taken in the frame of the truth file, for `similarity` and `camera` alike.
    """
    seen = visible_in_both(estimate, truth)
    x = _centred(truth, seen)
    size = np.abs(np.where(seen[:, None], truth, 0.0)).max(axis=(1, 2), initial=0.0)
    apart = np.ptp(x, axis=-1).max(axis=-1, initial=0.0) > 4 * np.finfo(float).eps * size
    with np.errstate(invalid="ignore"):  # where no landmark is judged
        spread = np.sqrt((x**2).sum(axis=-1) / seen.sum(axis=-1)[:, None]).mean(axis=-1)
    return np.where(apart, spread, np.nan)


def _centred(points: Floats, seen: Flags) -> Floats:
    """Points (n, d, p) less the mean of those that are seen (n, p); 0 where they are not."""
    points = np.where(seen[:, None], points, 0.0)
    mean = points.sum(axis=-1, keepdims=True) / np.maximum(seen.sum(axis=-1), 1)[:, None, None]
    return np.where(seen[:, None], points - mean, 0.0)


def visible_in_both(first: Floats, second: Floats) -> Flags:
    """Landmarks with finite coordinates on both sides; (n, d, p) each -> (n, p)."""
    visible: Flags = np.all(np.isfinite(first) & np.isfinite(second), axis=-2)
    return visible


def _mean_over_visible(values: Floats, visible: Flags, fewest: int) -> Floats:
    """Mean of the visible of values (n, p) -> (n,); nan with less than the fewest visible."""
    count = visible.sum(axis=-1)
    total = np.where(visible, values, 0.0).sum(axis=-1)
    return np.divide(total, count, out=np.full(len(values), np.nan), where=count >= fewest)


def precision(labelled: Flags, corrupted: Flags) -> Floats:
    """|labelled and corrupted| / |labelled| of each image (n,); nan where nothing is labelled."""
    return _share(labelled & corrupted, labelled)


def recall(labelled: Flags, corrupted: Flags) -> Floats:
    """|labelled and corrupted| / |corrupted| of each image (n,); nan where nothing is corrupted."""
    return _share(labelled & corrupted, corrupted)


def _share(part: Flags, whole: Flags) -> Floats:
    count = whole.sum(axis=-1)
    nothing = np.full(len(count), np.nan)
    return np.divide(part.sum(axis=-1), count, out=nothing, where=count > 0)


TOGETHER = 1 << 10
"""Images that are measured together: what is made of them stays in the processor's cache."""


def in_blocks(measure: Callable[..., Any], *arrays: NDArray[Any] | None) -> Any:
    """Return what a function of images, on their first axis, makes of arrays; some at a time.

    It returns an array (n, ...) or a tuple of them.
    """
    count = next(len(array) for array in arrays if array is not None)
    parts = [
        measure(*(None if array is None else array[row : row + TOGETHER] for array in arrays))
        for row in range(0, count, TOGETHER)
    ]
    if isinstance(parts[0], tuple):
        return tuple(map(np.concatenate, zip(*parts, strict=True)))
    return np.concatenate(parts)
