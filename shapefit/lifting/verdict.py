"""Whether the shape of an image is to be trusted, and whether a file is: two rules.

An image is trusted unless one of these holds, in this order; the first is its reason.

- There is no shape.
- Its landmarks leave no degree of freedom: m points have 2 m coordinates, and a view takes 6.
- Its p-value is below a limit.
- It is far from the shape of the convex program from which it started (ten or more landmarks).
- The class was learned from 2D landmarks, and nothing has told near from far.
- Its error bars are wide beside the shape.
- Left and right change places in its sequence for longer than a second.
- The solver stopped before an optimum.

They are taken from what a result stores: shapes, standard deviations, p-values, start distances.

A file of which a sample has been calibrated is not trusted at all where hidden landmarks are far
from what the others predict, or most of its shapes are far from where they started: wrong names,
another class, or poses that no training shape resembles. Neither rule notices left and right
exchanged in all frames, x and y exchanged, a turned video, a wrong focal length, or landmarks that
a detector invents within the image.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Floats, median
from shapefit.convex.solver import Status
from shapefit.lifting.estimate import CORRELATION, Estimate
from shapefit.lifting.posterior.p_value import VIEWED

TRUSTED, REASONS, P_VALUE = "trusted", "reasons", "p_value"
"""Datasets (n,) of a result: true or false, why not, and a p-value."""

START_DISTANCE = "start_distance"
"""Dataset (n,): similarity distance of the seen landmarks of a shape from those of the convex
program's, in units of the size of the shape."""


SIDES = "sides_exchanged"
"""Dataset (n,) of sequences: 1 where left and right were exchanged and are put back, 0 where they
are as the file has them, nan where they change places in the sequence and nobody knows which are
right."""


@dataclass(frozen=True)
class Limits:
    """The numbers of both rules, in one place; none is a key.

    min_p_value     of an image. By definition it doubts 5% of those that are as the model says;
                    without it 2 to 10% fewer of the errors above 0.4 are noticed
    max_width       mean_j sqrt(sum_a sd_aj^2) beside the size of the shape, the root of the mean
                    variance of its coordinates: 1 is a shape of which nothing is known
    max_distance    start distance of an image, and median of a file. Of right files of four other
                    bodies and of held-out animals 2 to 9% of the good images are beyond it, of
                    errors above 0.4 about 90%
    fewest_seen     landmarks of an image with which its start distance says something: with fewer
                    18 to 48% of good images are beyond it
    max_kappa       by which the variances of hidden landmarks are too small; see `calibration`.
                    None of 260 right files has more, 156 of 160 with wrong names have (or have no
                    kappa, or the distance)
    fewest_images   of a sample that says something of its file: the logarithm of kappa has a
                    standard deviation of 0.25 with 20 images, of 0.13 with 60
    """

    min_p_value: float = 0.05
    max_width: float = 0.8
    max_distance: float = 0.5
    fewest_seen: int = 10
    max_kappa: float = 2.5
    fewest_images: int = 20


LIMITS = Limits()

NO_SHAPE = "no shape"
TOO_FEW = "too few landmarks seen"
IMPLAUSIBLE = "implausible landmarks"
FAR = "far from any training shape"
MIRRORED = "near and far not told apart"
WIDE = "wide error bars"
UNSURE_SIDES = "left and right change places"
NOT_OPTIMAL = "not optimal"
NOT_OF_THE_CLASS = "landmarks of the file contradict the dictionary"


def find_reasons(
    shapes: Floats,
    deviation: Floats,
    seen: NDArray[np.integer],
    p_value: Floats,
    start_distance: Floats,
    status: Sequence[Status],
    *,
    sides: Floats | None = None,
    depth_ambiguity: bool = False,
) -> NDArray[np.object_]:
    """Return why each of n images is not to be trusted, "" where it is.

    shapes (n, 3, p), nan where there is none, and the standard deviations (n, 3, p) of their
    coordinates, in one unit; seen (n,), how many landmarks are; p_value and start_distance (n,),
    nan where nothing can be said; sides (n,), see `SIDES`; depth_ambiguity, see `Dictionary`.
    """
    failed = ~np.isfinite(shapes).all(axis=(1, 2))
    stopped = np.array([each is Status.ITERATION_LIMIT for each in status], dtype=bool)
    with np.errstate(invalid="ignore"):
        far = (start_distance > LIMITS.max_distance) & (seen >= LIMITS.fewest_seen)
        rules = (
            (failed, NO_SHAPE),
            (2 * seen <= VIEWED, TOO_FEW),
            (p_value < LIMITS.min_p_value, IMPLAUSIBLE),
            (far, FAR),
            (np.full(len(shapes), depth_ambiguity), MIRRORED),
            (relative_width(shapes, deviation) > LIMITS.max_width, WIDE),
            (np.isnan(np.zeros(len(shapes)) if sides is None else sides), UNSURE_SIDES),
            (stopped, NOT_OPTIMAL),
        )
    reasons = np.full(len(shapes), "", dtype=object)
    for holds, text in reversed(rules):
        reasons[holds] = text
    return reasons


def contradicts(kappa: float, distance: float) -> bool:
    """Whether a sample contradicts the dictionary: the rule for files.

    kappa of its hidden landmarks, nan where none could be predicted; distance, the median one of
    its images, see `median_distance`.
    """
    return distance > LIMITS.max_distance or not kappa <= LIMITS.max_kappa


def median_distance(start_distance: Floats, seen: NDArray[np.integer]) -> float:
    """Median start distance (n,) of the images with enough landmarks `seen` (n,).

    nan where these are fewer than `fewest_images`.
    """
    known = start_distance[np.isfinite(start_distance) & (seen >= LIMITS.fewest_seen)]
    return median(known) if len(known) >= LIMITS.fewest_images else float("nan")


def cover_mirror_image(estimate: Estimate) -> Estimate:
    """Widen error bars to those of a shape and its mirror image in depth, both as likely.

    About the shape S itself, with depths z of mean 0 and their covariance C:

        E (z' - z)(z' - z)^T = (C + (C + 4 z z^T)) / 2 = C + 2 z z^T,

    and depth is not correlated with x and y, as its sign is open.
    """
    if estimate.deviation is None:
        return estimate
    z = estimate.shapes[:, 2] - estimate.shapes[:, 2].mean(axis=1, keepdims=True)
    deviation = estimate.deviation.copy()
    deviation[:, 2] = np.sqrt(deviation[:, 2] ** 2 + 2 * z**2)
    covariance, p = estimate.covariance, z.shape[1]
    if covariance is not None:
        covariance = covariance.copy()
        covariance[:, : 2 * p, 2 * p :] = covariance[:, 2 * p :, : 2 * p] = 0.0
        covariance[:, 2 * p :, 2 * p :] += 2 * z[:, :, None] * z[:, None]
    further = dict(estimate.further)
    if CORRELATION in further:  # of x with y, x with z, y with z
        further[CORRELATION] = further[CORRELATION] * np.array([1, 0, 0], np.float32)
    return replace(estimate, deviation=deviation, covariance=covariance, further=further)


def relative_width(shapes: Floats, deviation: Floats) -> Floats:
    """mean_j sqrt(sum_a sd_aj^2) / spread of n shapes (n, 3, p): the error bar beside the body."""
    spread = np.sqrt(shapes.var(axis=2).mean(axis=1))
    bar = np.sqrt((deviation**2).sum(axis=1)).mean(axis=1)
    return np.divide(bar, spread, out=np.full_like(bar, np.inf), where=spread > 0)
