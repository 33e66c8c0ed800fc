"""Procrustes: points onto others, many shapes onto their mean; and mirror images."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Flags, Floats
from shapefit.geometry.rotations import nearest_rotation
from shapefit.threads import on_threads

SHAPES_AT_A_TIME = 1000
"""A thread turns as many in some milliseconds."""

MirrorIndex = NDArray[np.integer] | Sequence[int]
"""The partner of each point, itself for a point on the plane of symmetry."""


class Similarity(NamedTuple):
    """A similarity transform x -> scale * rotation @ x + translation.

    scale (...), rotation (..., 3, 3), translation (..., 3).
    """

    scale: Floats
    rotation: Floats
    translation: Floats

    def apply(self, points: Floats) -> Floats:
        """Return points (..., 3, p) scaled, rotated and translated."""
        turned = self.rotation @ points
        return self.scale[..., None, None] * turned + self.translation[..., None]


class Alignment(NamedTuple):
    """Shapes turned onto their mean: shapes = rotations @ original shapes.

    shapes (n, 3, p), mean (3, p), rotations (n, 3, 3) proper; `converged` states
    whether the mean came to rest within the rounds allowed.
    """

    shapes: Floats
    mean: Floats
    rotations: Floats
    rounds: int
    converged: bool


def rotation_onto(source: Floats, target: Floats) -> Floats:
    """Return the rotation (..., 3, 3) that turns source points onto targets best.

    argmin ||R source - target||_F over proper rotations R. source and target (..., 3,
    p), taken as they are (not centred); R (..., 3, 3). Where the minimiser is not
    unique, as for points on one line, one of them is returned, always the same; it is
    the identity where source or target is 0, and nan where an entry is nan. Source:
    Kabsch 1976, Umeyama 1991.
    """
    cross = target @ np.swapaxes(source, -1, -2)
    finite = np.isfinite(cross).all(axis=(-2, -1), keepdims=True)
    return np.where(finite, nearest_rotation(np.where(finite, cross, 0.0)), np.nan)


def similarity_transform(source: Floats, target: Floats) -> Similarity:
    """Return the similarity transform that moves source points onto targets best.

    argmin ||s R source + t 1^T - target||_F over s >= 0, proper rotations R and t.
    source and target (..., 3, p). s is the least-squares scale, <R source, target> /
    ||source||^2 of the centred points. Where the points of the source coincide s = 1
    and R = I, where those of the target do s = 0 and R = I. A nan makes its own
    transform nan. Source: Umeyama 1991.
    """
    source_middle = source.mean(axis=-1, keepdims=True)
    target_middle = target.mean(axis=-1, keepdims=True)
    X = np.where(are_coincident(source)[..., None, None], 0.0, source - source_middle)
    Y = np.where(are_coincident(target)[..., None, None], 0.0, target - target_middle)
    R, scale = _scaled_rotation(X, Y)
    moved_middle = scale[..., None, None] * (R @ source_middle)
    translation = (target_middle - moved_middle)[..., 0]
    return Similarity(scale, R, translation)


def similarity_errors(
    estimate: Floats, truth: Floats, min_landmarks: int = 3
) -> Floats:
    """Return the mean distance (n,) of estimated points from true ones, once aligned.

    By the similarity s, R, t that minimises sum_j |s R e_j + t - x_j|^2 over points j.
    estimate e and truth x (n, 3, p). Landmarks that are not finite on one side do not
    count; nan where fewer than `min_landmarks` do.
    """
    distance = aligned_distances(estimate, truth)
    finite = ~np.isnan(distance)
    count = finite.sum(axis=1)
    total = np.where(finite, distance, 0.0).sum(axis=1)
    return np.where(count >= min_landmarks, total / np.maximum(count, 1), np.nan)


def aligned_distances(estimate: Floats, truth: Floats) -> Floats:
    """Return distances (n, p) of estimated points from true ones, once aligned.

    |s R e_j + t - x_j| with the similarity s, R, t that minimises the sum of their
    squares. estimate e and truth x (n, 3, p); nan for landmarks that are not finite on
    one side, which do not count.
    """
    finite: Flags = np.asarray(np.isfinite(estimate + truth).all(axis=1))
    e = _centred_or_zero(estimate, finite)
    x = _centred_or_zero(truth, finite)
    R, scale = _scaled_rotation(e, x)
    residual = scale[:, None, None] * (R @ e) - x
    distance = np.sqrt((residual**2).sum(axis=1))
    return np.where(finite, distance, np.nan)


def _centred_or_zero(points: Floats, finite: Flags) -> Floats:
    """Centre points (n, d, p) on the mean of the finite ones; all 0 if these coincide.

    Points that are not finite (n, p) become 0.
    """
    if finite.size:
        first = finite.argmax(axis=1)[:, None, None]
    else:
        first = np.zeros((len(points), 1, 1), int)
    # a point that does not count lies where the first one does that counts
    filled = np.where(
        finite[:, None], points, np.take_along_axis(points, first, axis=2)
    )
    is_one_point = are_coincident(filled)[:, None, None]
    return np.where(is_one_point, 0.0, centred(filled, finite))


def are_coincident(points: Floats) -> Flags:
    """Return whether the points of each set (..., d, p) coincide up to rounding, (...).

    True for a set without points.
    """
    if points.shape[-1] == 0:
        return np.ones(points.shape[:-2], dtype=np.bool_)
    extent = np.ptp(points, axis=-1).max(axis=-1)
    size = np.abs(points).max(axis=(-2, -1))
    return np.asarray(extent <= 4 * np.finfo(np.float64).eps * size)


def centred(points: Floats, finite: Flags) -> Floats:
    """Centre points (n, d, p) on the mean of the finite ones (n, p), others being 0."""
    points = np.where(finite[:, None], points, 0.0)
    count = np.maximum(finite.sum(axis=-1), 1)
    mean = points.sum(axis=-1, keepdims=True) / count[:, None, None]
    return np.where(finite[:, None], points - mean, 0.0)


def _scaled_rotation(X: Floats, Y: Floats) -> tuple[Floats, Floats]:
    """Return rotation (..., 3, 3) and scale (...) that bring X onto Y best.

    argmin ||s R X - Y||_F of centred points (..., 3, p); s is 1 where X = 0.
    """
    R = rotation_onto(X, Y)
    size = (X**2).sum(axis=(-2, -1))
    overlap = ((R @ X) * Y).sum(axis=(-2, -1))
    scale = np.divide(overlap, size, out=np.ones_like(size), where=size != 0)
    return R, scale


def generalised_procrustes(
    shapes: Floats,
    landmarks: Sequence[int] | None = None,
    tolerance: float = 1e-8,
    max_rounds: int = 100,
) -> Alignment:
    """Turn all shapes onto their common mean (generalised Procrustes alignment).

    min sum_j ||(R_j S_j - mean) P||_F^2 over proper rotations R_j and the mean. shapes
    (n, 3, p), each centred and normalised already: scale and position stay as they are.
    P keeps the given landmarks (None: all) and subtracts their centroid. Each round
    turns every shape onto the mean and averages again, until the mean moves by at most
    `tolerance` of its norm. The first mean is the first shape, and the answer is given
    in its frame (rotations[0] = I). Source: Gower 1975.
    """
    chosen = choose_landmarks(shapes, landmarks)
    starts = range(0, len(chosen), SHAPES_AT_A_TIME)
    parts = [chosen[start : start + SHAPES_AT_A_TIME] for start in starts]
    mean = chosen[0]
    converged = False
    rounds = 0
    while not converged and rounds < max_rounds:
        rounds += 1
        onto_mean = partial(rotation_onto, target=mean)
        R = np.concatenate(on_threads(onto_mean, parts, 0))
        previous = mean
        mean = np.einsum("jab,jbp->ap", R, chosen) / len(chosen)
        change = np.linalg.norm(mean - previous)
        converged = bool(change <= tolerance * np.linalg.norm(previous))
    R = R[0].T @ R
    R[0] = np.eye(3)
    aligned = R @ shapes
    return Alignment(aligned, aligned.mean(axis=0), R, rounds, converged)


def choose_landmarks(shapes: Floats, landmarks: Sequence[int] | None) -> Floats:
    """Select landmarks by index (None: all) of shapes (..., 3, p), and centre them."""
    chosen = shapes if landmarks is None else shapes[..., list(landmarks)]
    centred: Floats = chosen - chosen.mean(axis=-1, keepdims=True)
    return centred


def mirror(shapes: Floats, mirror_index: MirrorIndex, lateral: int = 0) -> Floats:
    """Mirror shapes (..., 3, p): exchange left and right points, negate axis `lateral`.

    The shapes are in a frame whose plane of symmetry is `lateral` = 0 (x, y, z = 0, 1,
    2); mirror_index (p,): the partner of each point, itself for a point on the plane.
    """
    mirrored: Floats = shapes[..., mirror_index]
    mirrored[..., lateral, :] *= -1
    return mirrored


def lateral_axis(shapes: Floats, mirror_index: MirrorIndex) -> int:
    """Return the axis along which left and right lie apart: 0, 1 or 2.

    argmax_a sum over points of (x_a - x_a of the partner)^2. shapes (..., 3, p) are in
    frames that share their lateral axis.
    """
    difference = shapes - shapes[..., mirror_index]
    squares = (difference**2).sum(axis=-1).reshape(-1, 3)
    return int(squares.sum(axis=0).argmax())
