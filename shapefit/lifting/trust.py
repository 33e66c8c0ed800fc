"""Whether the shape of an image is to be trusted, and whether a file is: two rules.

An image is trusted unless one of these holds, in this order; the first is its reason.

- There is no shape.
- Its landmarks leave no degree of freedom: m points have 2 m coordinates, and a view
  takes 6.
- Its p-value is below a limit.
- It is far from the shape of the convex program from which it started (ten or more
  landmarks).
- The class was learned from 2D landmarks, and nothing has told near from far.
- The error to expect of it is more than 0.305 of the size of the shape. Both are those
  of the landmarks that most images of the file show and that depend on no other: of a
  man behind a desk his legs are a guess, and he is to be trusted without them.
- Left and right change places in its sequence for longer than a second.
- The solver stopped before an optimum.

They are taken from what a result stores: shapes, expected errors, p-values, start
distances.

A file of which a sample has been calibrated is not trusted at all where hidden
landmarks are far from what the others predict, most of its shapes are far from where
they started, or next to none would be trusted: wrong names, another class, or poses
that no training shape resembles; nor where x and y have different scales. Neither rule
notices left and right exchanged in all frames, x and y exchanged, a turned video, a
wrong focal length, or landmarks that a detector invents within the image.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Flags, Floats, median
from shapefit.convex.solver import Status
from shapefit.geometry.normalisation import std
from shapefit.lifting.estimate import PosteriorEstimate

VIEW_NUMBERS = 6
"""Rotation, scale and translation: they take up as many of the 2 m coordinates."""

TRUSTED = "trusted"
"""Dataset (n,) of a result: true or false."""

REASONS = "reasons"
"""Dataset (n,) of a result: why an image is not trusted."""

P_VALUE = "p_value"
"""Dataset (n,) of a result."""

START_DISTANCE = "start_distance"
"""Dataset (n,): similarity distance of the visible landmarks of a shape from those of
the convex program's, in units of the size of the shape.
"""

SIDES = "sides_exchanged"
"""Dataset (n,) of sequences: 1 where left and right were exchanged and are put back, 0
where they are as the file has them, nan where they change places in the sequence and
nobody knows which are right.
"""


class Limits(NamedTuple):
    """The numbers of both rules, in one place; none is a key."""

    min_p_value: float = 0.05
    """Of an image.

    By definition it flags 5% of those that are as the model says; without it 2 to 10%
    fewer of the errors above 0.4 are noticed.
    """

    max_error: float = 0.305
    """Expected error in sizes of the shape.

    On film of seven bodies that the dictionary does not know (`benchmarks.verdicts`,
    whole bodies and half ones) it doubts 8% of the single images whose error is below
    0.25 and 53% of those above 0.4; with truths drawn from the posteriors themselves no
    rule finds more than 62 to 71% of these at 10% of the former.
    """

    max_distance: float = 0.5
    """Start distance of an image, and median of a file.

    Of right files of four other bodies and of held-out animals 2 to 9% of the good
    images are beyond it, of errors above 0.4 about 90%.
    """

    min_visible: int = 10
    """Landmarks of an image with which its start distance says something.

    With fewer, 18 to 48% of good images are beyond it.
    """

    min_trusted: float = 0.1
    """Share of a sample that would be trusted.

    Where it is less, and more than max_doubtful is implausible or far, what passes does
    so by chance. Without it 2 of 20 clips whose names are moved by one landmark have 4%
    of trusted images; none of 72 right files of nine bodies on film is affected.
    """

    max_doubtful: float = 0.25
    """Share of a sample that is implausible or far, see min_trusted."""

    mostly_trusted: float = 0.5
    """Share of a sample that would be trusted, with bars as wide as kappa asks for,
    from which neither kappa nor the distance refuses a file.

    A motion or class unlike training is told apart image by image. Of film whose names
    are moved by one landmark, mixed, or exchanged between arms and legs 0 to 2% would
    be.
    """

    max_kappa: float = 2.5
    """By which the variances of hidden landmarks are too small; see `calibration`.

    None of 260 right files has more, 156 of 160 with wrong names have (or have no
    kappa, or the distance).
    """

    min_images: int = 20
    """Of a sample that says something of its file.

    The logarithm of kappa has a standard deviation of 0.25 with 20 images, of 0.13 with
    60.
    """


LIMITS = Limits()

MIN_INLIER_PROBABILITY = 0.5
"""Inlier probability from which a landmark counts as an inlier."""

NO_SHAPE = "no shape"
TOO_FEW = "too few landmarks seen"
IMPLAUSIBLE = "implausible landmarks"
FAR_FROM_TRAINING = "far from any training shape"
DEPTH_OPEN = "near and far not told apart"
LARGE_ERROR = "large expected error"
UNSURE_SIDES = "left and right change places"
NOT_OPTIMAL = "not optimal"
STRETCHED = "x and y have different scales"
NOT_OF_THE_CLASS = "landmarks of the file contradict the dictionary"


def find_reasons(
    shapes: Floats,
    expected: Floats,
    visible: NDArray[np.integer],
    p_value: Floats,
    start_distance: Floats,
    status: Sequence[Status],
    *,
    sides: Floats | None = None,
    depth_ambiguity: bool = False,
    shown: Flags | None = None,
) -> NDArray[np.object_]:
    """Return why each of n images is not to be trusted, "" where it is.

    shapes (n, 3, p), nan where there is none, and their expected errors (n,), in one
    unit; visible (n,), how many landmarks are; p_value and start_distance (n,), nan
    where nothing can be said; sides (n,), see `SIDES`; depth_ambiguity, see
    `Dictionary`; shown (p,), the landmarks whose errors and size count, all by default.
    """
    n = len(shapes)
    if sides is None:
        sides = np.zeros(n)
    of_shown = shapes if shown is None else shapes[..., shown]
    has_shape = np.isfinite(shapes).all(axis=(1, 2))
    is_stopped = [value is Status.ITERATION_LIMIT for value in status]
    with np.errstate(invalid="ignore"):
        is_far = start_distance > LIMITS.max_distance
        is_far &= visible >= LIMITS.min_visible
        holds = [
            (np.asarray(~has_shape), NO_SHAPE),
            (2 * visible <= VIEW_NUMBERS, TOO_FEW),
            (p_value < LIMITS.min_p_value, IMPLAUSIBLE),
            (is_far, FAR_FROM_TRAINING),
            (np.full(n, depth_ambiguity), DEPTH_OPEN),
            (expected > LIMITS.max_error * std(of_shown), LARGE_ERROR),
            (np.isnan(sides), UNSURE_SIDES),
            (np.array(is_stopped, dtype=bool), NOT_OPTIMAL),
        ]
    reasons = np.full(n, "", dtype=object)
    for images, reason in reversed(holds):  # the first one that holds stays
        reasons[images] = reason
    return reasons


def contradicts_dictionary(
    kappa: float, distance: float, trusted_share: float, doubtful_share: float
) -> bool:
    """Whether these figures of a sample show that its file contradicts the dictionary.

    kappa of its hidden landmarks, nan where none could be predicted; distance, the
    median one of its images, see `median_distance`; shares of the sample that would be
    trusted with the bars that kappa leaves, and that is implausible or far from where
    it started.
    """
    has_few_trusted = trusted_share < LIMITS.min_trusted
    by_chance = has_few_trusted and doubtful_share > LIMITS.max_doubtful
    is_predicted = kappa <= LIMITS.max_kappa  # nan is not
    is_unlike = distance > LIMITS.max_distance or not is_predicted
    return by_chance or (is_unlike and trusted_share < LIMITS.mostly_trusted)


def median_distance(start_distance: Floats, visible: NDArray[np.integer]) -> float:
    """Return the median distance of posteriors from the shapes they started from.

    start_distance (n,), see `find_start_distance`; nan where too few images have one.
    visible (n,), the landmarks seen: images with fewer than `LIMITS.min_visible` do
    not count, and `LIMITS.min_images` must.
    """
    says_something = np.isfinite(start_distance) & (visible >= LIMITS.min_visible)
    distances = start_distance[says_something]
    if len(distances) < LIMITS.min_images:
        return float("nan")
    return median(distances)


def cover_mirror_image(estimate: PosteriorEstimate) -> PosteriorEstimate:
    """Widen error bars to those of a shape and its mirror image in depth.

    Both are as likely. About the shape S itself, with depths z of mean 0 and their
    covariance C:

        E (z' - z)(z' - z)^T = (C + (C + 4 z z^T)) / 2 = C + 2 z z^T,

    and depth is not correlated with x and y, as its sign is open.
    """
    z = estimate.shapes[:, 2] - estimate.shapes[:, 2].mean(axis=1, keepdims=True)
    deviation = estimate.deviation.copy()
    deviation[:, 2] = np.sqrt(deviation[:, 2] ** 2 + 2 * z**2)
    covariance = estimate.covariance
    if covariance is not None:
        in_image = slice(2 * z.shape[1])
        in_depth = slice(2 * z.shape[1], None)
        covariance = covariance.copy()
        covariance[:, in_image, in_depth] = 0.0
        covariance[:, in_depth, in_image] = 0.0
        covariance[:, in_depth, in_depth] += 2 * z[:, :, None] * z[:, None]
    only_x_with_y = np.array([1, 0, 0], np.float32)[:, None]
    correlation = estimate.correlation * only_x_with_y
    return replace(
        estimate, deviation=deviation, covariance=covariance, correlation=correlation
    )


EXPECTED_ERROR = "expected_error"
"""Dataset (n,) in the unit of the shapes."""

IMAGE_ERROR = "image_error"
"""Dataset (n,) of sequences: the expected error of the image alone, in the unit of the
shapes.
"""

SEQUENCE_ERROR_SHARE = 0.86
"""Errors of sequences beside those of their images, on film. The error bars of a
sequence do not know of errors that last as long as it does, so that less than this
share is not expected of it.
"""

MEASURED_ERROR_SHARE = 0.77
"""Error that was measured beside that which is expected: error bars are made to hold
90%, not to have the mean of the errors. On film of six bodies (72 cells and bodies):
single images 0.78, whole sequences 0.75.
"""

MIN_ALIGNED_LANDMARKS = 3
"""Fewest whose 3p coordinates are more than the 7 directions of an alignment."""

IMAGES_AT_ONCE = 128
"""Whose expected errors are found together: their covariances stay in the cache."""


def expected_error(
    shapes: Floats, covariance: Floats, shown: Flags | None = None
) -> Floats:
    """Return the expected mean distance (n,) of landmarks from the truth, once aligned.

    After alignment by a similarity: `MEASURED_ERROR_SHARE` times E mean_j ||d_j|| of
    errors d ~ N(0, P C P). Translations, rotations and the scale move a shape S in
    seven directions e_a, omega x S and S of its 3p coordinates, which an alignment
    takes off; P projects onto what is left. Of a Gaussian with the covariance A, to
    second order,

        E ||d|| = sqrt(tr A) (1 - tr(A^2) / (4 tr(A)^2)).

    shapes (n, 3, p); covariance C (n, 3p, 3p), all x first, then y, then z; shown (p,),
    landmarks that count, all by default; returns (n,), nan where either is not finite,
    or where fewer than 3 landmarks count, all of which an alignment takes off.
    """
    if shown is not None and not shown.all():
        rows = np.flatnonzero(np.tile(shown, 3))
        shapes = shapes[..., shown]
        covariance = covariance[:, rows[:, None], rows]
    n, _, p = shapes.shape
    if p < MIN_ALIGNED_LANDMARKS:
        return np.full(n, np.nan)
    if n > IMAGES_AT_ONCE:
        parts = [
            slice(start, start + IMAGES_AT_ONCE)
            for start in range(0, n, IMAGES_AT_ONCE)
        ]
        return np.concatenate(
            [expected_error(shapes[part], covariance[part]) for part in parts]
        )
    has_shape = np.isfinite(shapes).all(axis=(1, 2))
    has_covariance = np.isfinite(covariance).all(axis=(1, 2))
    is_finite: Flags = np.asarray(has_shape & has_covariance)
    S = np.where(is_finite[:, None, None], shapes, np.eye(3, p))
    C = np.where(is_finite[:, None, None], covariance, 0.0)
    A = _without_similarities(S, C)
    trace = np.maximum(np.trace(A, axis1=2, axis2=3), 0.0)
    whole = trace[..., None, None]
    share = np.divide(A, whole, out=np.zeros_like(A), where=whole > 0)
    length = np.sqrt(trace) * (1 - (share**2).sum(axis=(2, 3)) / 4)
    error = MEASURED_ERROR_SHARE * length.mean(axis=1)
    return np.where(is_finite, error, np.nan)


def _without_similarities(S: Floats, C: Floats) -> Floats:
    """Return covariances (n, p, 3, 3) of landmarks: C without similarities of S.

    The blocks of P C P on its diagonal, see `expected_error`. With orthonormal
    directions Q (3p, 7) of similarities, P C P = C - Q Q^T C - C Q Q^T + Q (Q^T C Q)
    Q^T.
    """
    n, _, p = S.shape
    Q, _ = np.linalg.qr(_directions_of_similarities(S))
    CQ = C @ Q
    middle = Q.swapaxes(1, 2) @ CQ
    q = Q.reshape(n, 3, p, 7).transpose(0, 2, 1, 3)
    cq = CQ.reshape(n, 3, p, 7).transpose(0, 2, 1, 3)
    every = range(p)
    A = C.reshape(n, 3, p, 3, p)[:, :, every, :, every].transpose(1, 0, 2, 3)
    across = q @ cq.swapaxes(2, 3)
    inside = q @ middle[:, None] @ q.swapaxes(2, 3)
    return np.asarray(A - across - across.swapaxes(2, 3) + inside)


def _directions_of_similarities(S: Floats) -> Floats:
    """Return directions (n, 3p, 7) in which similarities move shapes S (n, 3, p)."""
    n, _, p = S.shape
    x, y, z = (S - S.mean(axis=2, keepdims=True)).transpose(1, 0, 2)
    zero = np.zeros_like(x)
    one = np.ones_like(x)
    translations = [[one, zero, zero], [zero, one, zero], [zero, zero, one]]
    rotations = [[zero, -z, y], [z, zero, -x], [-y, x, zero]]
    scale = [x, y, z]
    directions = np.array([*translations, *rotations, scale])
    return directions.transpose(2, 1, 3, 0).reshape(n, 3 * p, 7)
