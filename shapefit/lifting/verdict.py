"""Whether the shape of an image is to be trusted: one rule over what a method knows of its error.

An image is trusted unless one of these holds, in this order; the first is its reason.

- There is no shape.
- Its landmarks leave no degree of freedom: m points have 2 m coordinates, and a view takes 6.
- Its plausibility is below a limit.
- The class was learned from 2D landmarks, and nothing has told near from far.
- Its error bars are wide: mean_j sqrt(sum_a sd_aj^2) exceeds WIDEST times the spread of the
  shape, the root of the mean variance of its coordinates.
- The solver stopped before the optimum of the convex program from which the view starts.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Floats
from shapefit.convex.solver import Status
from shapefit.lifting.estimate import CORRELATION, Estimate
from shapefit.lifting.posterior.p_value import VIEWED

TRUSTED, REASONS, P_VALUE = "trusted", "reasons", "p_value"
"""Datasets (n,) of a result: true or false, why not, and a p-value."""

WIDEST = 0.8
"""Width of error bars beside the spread of the shape beyond which it is not to be trusted."""

NO_SHAPE = "no shape"
TOO_FEW = "too few landmarks seen"
IMPLAUSIBLE = "implausible landmarks"

MIN_P_VALUE = 0.05
"""Images with a smaller p-value are not to be trusted."""
MIRRORED = "near and far not told apart"
WIDE = "wide error bars"
NOT_OPTIMAL = "not optimal"


def find_doubts(
    shapes: Floats,
    deviation: Floats,
    seen: NDArray[np.bool_],
    p_value: Floats,
    status: Sequence[Status],
    *,
    implausible: float,
    depth_ambiguity: bool = False,
) -> NDArray[np.object_]:
    """Return why each of n images is not to be trusted, "" where it is.

    shapes (n, 3, p), nan where there is none, and the standard deviations (n, 3, p) of their
    coordinates, in one unit; seen (n, p); plausibility (n,), nan where nothing can be said;
    depth_is_open, see `Dictionary`.
    """
    failed = ~np.isfinite(shapes).all(axis=(1, 2))
    stopped = np.array([each is Status.ITERATION_LIMIT for each in status], dtype=bool)
    with np.errstate(invalid="ignore"):
        rules = (
            (failed, NO_SHAPE),
            (2 * seen.sum(axis=1) <= VIEWED, TOO_FEW),
            (p_value < implausible, IMPLAUSIBLE),
            (np.full(len(shapes), depth_ambiguity), MIRRORED),
            (relative_width(shapes, deviation) > WIDEST, WIDE),
            (stopped, NOT_OPTIMAL),
        )
    reasons = np.full(len(shapes), "", dtype=object)
    for holds, text in reversed(rules):
        reasons[holds] = text
    return reasons


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
