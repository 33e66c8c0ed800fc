"""Errors of estimated shapes and landmarks, one number per image.

All functions take whole sets of images, and leave out, image by image, the landmarks that are nan
on either side. An image with too few landmarks left has the error nan: it failed.
"""

from __future__ import annotations

import numpy as np

from shapefit.arrays import Flags, Floats
from shapefit.geometry.normalisation import centroid, spread
from shapefit.geometry.procrustes import coincide, similarity_transform

FEWEST_LANDMARKS = 3
"""A similarity or a camera makes any two points coincide, so fewer say nothing."""


def similarity(estimate: Floats, truth: Floats) -> Floats:
    """min over s, R, t of sum_j |s R e_j + t - x_j|^2; then the mean over j of that distance.

    estimate and truth (n, 3, p) in any two frames -> (n,), in the unit of the truth. R is proper:
    a mirrored estimate is not forgiven.
    """
    visible = visible_in_both(estimate, truth)
    source, target = _filled(estimate, visible), _filled(truth, visible)
    aligned = similarity_transform(source, target).apply(source)
    return _mean_distance(aligned, target, visible)


def camera(estimate: Floats, truth: Floats, rotation: Floats) -> Floats:
    """min over s >= 0, t of sum_j |s e_j + t - R x_j|^2; then the mean over j of that distance.

    estimate (n, 3, p) in the camera frame; truth (n, 3, p) in the frame of its file and rotation
    (n, 3, 3) from there to the camera -> (n,), in the unit of the truth.
    """
    turned = rotation @ truth
    visible = visible_in_both(estimate, turned)
    apart, _ = placed_apart(estimate, turned)
    return _mean_over_visible(np.linalg.norm(apart, axis=-2), visible, fewest=FEWEST_LANDMARKS)


def placed_apart(estimate: Floats, turned: Floats) -> tuple[Floats, Floats]:
    """min over s >= 0, t of sum_j |s e_j + t - y_j|^2; then s e_j + t - y_j (n, 3, p), and s (n,).

    estimate e and the truth y (n, 3, p), both in the camera frame; hidden landmarks are 0 apart.
    """
    visible = visible_in_both(estimate, turned)
    source = _filled(estimate, visible) - centroid(estimate, visible)[..., None]
    target = _filled(turned, visible) - centroid(turned, visible)[..., None]
    size = (source**2).sum(axis=(-2, -1))
    overlap = np.maximum((source * target).sum(axis=(-2, -1)), 0.0)
    scale = np.divide(overlap, size, out=np.zeros_like(size), where=size > 0)
    return scale[:, None, None] * source - target, scale


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
    visible = visible_in_both(estimate, truth)
    flat = coincide(_filled(truth, visible))
    return np.where(flat, np.nan, spread(truth, visible))


def visible_in_both(first: Floats, second: Floats) -> Flags:
    """Landmarks with finite coordinates on both sides; (n, d, p) each -> (n, p)."""
    visible: Flags = np.all(np.isfinite(first) & np.isfinite(second), axis=-2)
    return visible


def _filled(points: Floats, visible: Flags) -> Floats:
    """Put hidden points on the centroid, where they change neither similarity nor scale."""
    return np.where(visible[..., None, :], points, centroid(points, visible)[..., None])


def _mean_distance(first: Floats, second: Floats, visible: Flags) -> Floats:
    distance = np.linalg.norm(first - second, axis=-2)
    return _mean_over_visible(distance, visible, fewest=FEWEST_LANDMARKS)


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
