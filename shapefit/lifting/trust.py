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

VIEWED = 6
"""Numbers of a view: rotation, scale, translation; they take up as many of the 2 m
coordinates.
"""

TRUSTED, REASONS, P_VALUE = "trusted", "reasons", "p_value"
"""Datasets (n,) of a result: true or false, why not, and a p-value."""

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
    """The numbers of both rules, in one place; none is a key.

    min_p_value     of an image. By definition it flags 5% of those that are as the
                    model says;
                    without it 2 to 10% fewer of the errors above 0.4 are noticed
    max_error       expected error in sizes of the shape. On film of seven bodies that
                    the dictionary does not know (`benchmarks.verdicts`, whole bodies
                    and half ones) it doubts 8% of the single images whose error is
                    below 0.25 and 53% of those above 0.4; with truths drawn from the
                    posteriors themselves no rule finds more than 62 to 71% of these at
                    10% of the former
    max_distance    start distance of an image, and median of a file. Of right files of
                    four other
                    bodies and of held-out animals 2 to 9% of the good images are beyond
                    it, of errors above 0.4 about 90%
    fewest_visible  landmarks of an image with which its start distance says something:
                    with fewer
                    18 to 48% of good images are beyond it
    min_trusted     share of a sample that would be trusted; where it is less, and more
    max_doubtful    than max_doubtful is implausible or far, what passes does so by
                    chance. Without it 2 of 20 clips whose names are moved by one
                    landmark have 4% of trusted images; none of 72 right files of nine
                    bodies on film is affected
    mostly_trusted  share of a sample that would be trusted, with bars as wide as kappa
                    asks for, from which neither kappa nor the distance refuses a file:
                    a motion or class unlike training is told apart image by image. Of
                    film whose names are moved by one landmark, mixed, or exchanged
                    between arms and legs 0 to 2% would be
    max_kappa       by which the variances of hidden landmarks are too small; see
                    `calibration`.
                    None of 260 right files has more, 156 of 160 with wrong names have
                    (or have no kappa, or the distance)
    fewest_images   of a sample that says something of its file: the logarithm of kappa
                    has a
                    standard deviation of 0.25 with 20 images, of 0.13 with 60
    """

    min_p_value: float = 0.05
    max_error: float = 0.305
    max_distance: float = 0.5
    fewest_visible: int = 10
    min_trusted: float = 0.1
    max_doubtful: float = 0.25
    mostly_trusted: float = 0.5
    max_kappa: float = 2.5
    fewest_images: int = 20


LIMITS = Limits()

NO_SHAPE = "no shape"
TOO_FEW = "too few landmarks seen"
IMPLAUSIBLE = "implausible landmarks"
FAR = "far from any training shape"
MIRRORED = "near and far not told apart"
WIDE = "large expected error"
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
    of_shown = shapes if shown is None else shapes[..., shown]
    failed = ~np.isfinite(shapes).all(axis=(1, 2))
    stopped = np.array(
        [value is Status.ITERATION_LIMIT for value in status], dtype=bool
    )
    with np.errstate(invalid="ignore"):
        far = (start_distance > LIMITS.max_distance) & (
            visible >= LIMITS.fewest_visible
        )
        rules = (
            (failed, NO_SHAPE),
            (2 * visible <= VIEWED, TOO_FEW),
            (p_value < LIMITS.min_p_value, IMPLAUSIBLE),
            (far, FAR),
            (np.full(len(shapes), depth_ambiguity), MIRRORED),
            (expected > LIMITS.max_error * std(of_shown), WIDE),
            (np.isnan(np.zeros(len(shapes)) if sides is None else sides), UNSURE_SIDES),
            (stopped, NOT_OPTIMAL),
        )
    reasons = np.full(len(shapes), "", dtype=object)
    for holds, text in reversed(rules):
        reasons[holds] = text
    return reasons


def contradicts(kappa: float, distance: float, trusted: float, doubtful: float) -> bool:
    """Whether a sample contradicts the dictionary: the rule for files.

    kappa of its hidden landmarks, nan where none could be predicted; distance, the
    median one of its images, see `median_distance`; shares of the sample that would be
    trusted with the bars that kappa leaves, and that is implausible or far from where
    it started.
    """
    by_chance = trusted < LIMITS.min_trusted and doubtful > LIMITS.max_doubtful
    unlike = distance > LIMITS.max_distance or not kappa <= LIMITS.max_kappa
    return by_chance or (unlike and trusted < LIMITS.mostly_trusted)


def median_distance(start_distance: Floats, visible: NDArray[np.integer]) -> float:
    """Median start distance (n,) of the images with enough landmarks `visible` (n,).

    nan where these are fewer than `fewest_images`.
    """
    distances = start_distance[
        np.isfinite(start_distance) & (visible >= LIMITS.fewest_visible)
    ]
    return median(distances) if len(distances) >= LIMITS.fewest_images else float("nan")


def cover_mirror_image(estimate: PosteriorEstimate) -> PosteriorEstimate:
    """Widen error bars to those of a shape and its mirror image in depth, both as
    likely.

    About the shape S itself, with depths z of mean 0 and their covariance C:

        E (z' - z)(z' - z)^T = (C + (C + 4 z z^T)) / 2 = C + 2 z z^T,

    and depth is not correlated with x and y, as its sign is open.
    """
    z = estimate.shapes[:, 2] - estimate.shapes[:, 2].mean(axis=1, keepdims=True)
    deviation = estimate.deviation.copy()
    deviation[:, 2] = np.sqrt(deviation[:, 2] ** 2 + 2 * z**2)
    covariance, p = estimate.covariance, z.shape[1]
    if covariance is not None:
        covariance = covariance.copy()
        covariance[:, : 2 * p, 2 * p :] = covariance[:, 2 * p :, : 2 * p] = 0.0
        covariance[:, 2 * p :, 2 * p :] += 2 * z[:, :, None] * z[:, None]
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

GAIN = 0.86
"""Errors of sequences beside those of their images, on film. The error bars of a
sequence do not know of errors that last as long as it does, so that less than this
share is not expected of it.
"""

CALIBRATED = 0.77
"""Error that was measured beside that which is expected: error bars are made to hold
90%, not to have the mean of the errors. On film of six bodies (72 cells and bodies):
single images 0.78, whole sequences 0.75.
"""

SLICE = 128
"""Images whose expected errors are found together: their covariances stay in the cache.
"""


def expected_error(
    shapes: Floats, covariance: Floats, shown: Flags | None = None
) -> Floats:
    """Calibrated E mean_j ||d_j|| of errors d ~ N(0, P C P), P without a similarity's
    directions.

    Translations, rotations and the scale move a shape S in seven directions e_a, omega
    x S and S of its 3p coordinates, which an alignment takes off; P projects onto what
    is left. Of a Gaussian with the covariance A, to second order,

        E ||d|| = sqrt(tr A) (1 - tr(A^2) / (4 tr(A)^2)).

    shapes (n, 3, p); covariance C (n, 3p, 3p), all x first, then y, then z; shown (p,),
    landmarks that count, all by default; returns (n,), nan where either is not finite.
    """
    if shown is not None and not shown.all():
        of = np.flatnonzero(np.tile(shown, 3))
        shapes, covariance = shapes[..., shown], covariance[:, of[:, None], of]
    n, _, p = shapes.shape
    if n > SLICE:
        slices = [slice(first, first + SLICE) for first in range(0, n, SLICE)]
        return np.concatenate(
            [expected_error(shapes[part], covariance[part]) for part in slices]
        )
    finite: Flags = np.asarray(
        np.isfinite(shapes).all(axis=(1, 2)) & np.isfinite(covariance).all(axis=(1, 2))
    )
    S = np.where(finite[:, None, None], shapes, np.eye(3, p))
    C = np.where(finite[:, None, None], covariance, 0.0)
    x, y, z = (S - S.mean(axis=2, keepdims=True)).transpose(1, 0, 2)
    zero, one = np.zeros_like(x), np.ones_like(x)
    directions = np.array(
        [
            [one, zero, zero],
            [zero, one, zero],
            [zero, zero, one],
            [zero, -z, y],
            [z, zero, -x],
            [-y, x, zero],
            [x, y, z],
        ]
    )
    Q, _ = np.linalg.qr(directions.transpose(2, 1, 3, 0).reshape(n, 3 * p, 7))
    CQ = C @ Q
    middle = Q.swapaxes(1, 2) @ CQ
    q, cq = (M.reshape(n, 3, p, 7).transpose(0, 2, 1, 3) for M in (Q, CQ))
    A = C.reshape(n, 3, p, 3, p)[:, :, range(p), :, range(p)].transpose(1, 0, 2, 3)
    across = q @ cq.swapaxes(2, 3)
    A = A - across - across.swapaxes(2, 3) + q @ middle[:, None] @ q.swapaxes(2, 3)
    trace = np.maximum(np.trace(A, axis1=2, axis2=3), 0.0)
    some = trace > 0
    share = np.divide(
        A, trace[..., None, None], out=np.zeros_like(A), where=some[..., None, None]
    )
    length = np.sqrt(trace) * (1 - (share**2).sum(axis=(2, 3)) / 4)
    return np.where(finite, CALIBRATED * length.mean(axis=1), np.nan)
