"""Whether error bars are true: how much of the truth they hold, and their width."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple, TypedDict

import numpy as np

from shapefit.arrays import Floats
from shapefit.evaluation.metrics import MIN_COMMON_LANDMARKS, visible_in_both

SQUARED_RADII = {0.5: 2.3659738843753377, 0.9: 6.251388631170325}
"""Nominal share of the truth -> squared Mahalanobis radius of its ellipsoid: quantiles
of chi^2 with 3 degrees of freedom.
"""

WIDTH_SHARE = 0.9
"""Of the ellipsoid whose width is reported, and that an image's share is of."""

WIDTH_SQUARED_RADIUS = SQUARED_RADII[WIDTH_SHARE]
"""Of that ellipsoid."""

MIN_VARIANCE_SHARE = 1e-12
"""Of a variance that is left where correlations leave none."""


class ErrorBars(NamedTuple):
    """How far the truth is in error bars, and how wide these are, of n images.

    square (n, p): the squared Mahalanobis distance of the truth, chi^2 with 3 degrees
    of freedom where error bars are true; width (n, p): root of the mean squared
    semi-axis of the 90% ellipsoid, by unit. nan where there is no truth or no error
    bar.
    """

    square: Floats
    width: Mapping[str, Floats]

    def coverage_by_image(self) -> Floats:
        """Return the share (n,) of each image's landmarks inside their 90% ellipsoids.

        nan where an image has no error bars to judge.
        """
        count = (~np.isnan(self.square)).sum(axis=1)
        inside = (self.square <= WIDTH_SQUARED_RADIUS).sum(axis=1)
        coverage = np.full(len(count), np.nan)
        np.divide(inside, count, out=coverage, where=count > 0)
        return coverage

    def coverage(self, levels: Floats) -> Floats:
        """Return the share (l,) of all landmarks inside their ellipsoids of each level.

        levels (l,): nominal shares between 0 and 1, which are what true error bars
        hold.
        """
        from scipy.special import gammaincinv

        squares = np.sort(self.square[~np.isnan(self.square)])
        # chi^2 with 3 degrees of freedom is twice a gamma variable of shape 3 / 2
        radii = 2 * gammaincinv(1.5, levels)
        inside = np.searchsorted(squares, radii, side="right")
        return np.asarray(inside / len(squares))


class Coverage(TypedDict):
    """How many true landmarks the error bars of a method hold in a group.

    counted, how many landmarks there are; inside, the share of each of SQUARED_RADII;
    median_width by unit.
    """

    method: str
    group: str
    counted: int
    inside: list[float]
    median_width: dict[str, float]


def measure_error_bars(
    estimate: Floats,
    truth: Floats,
    rotation: Floats,
    deviation: Floats,
    correlation: Floats | None,
) -> tuple[Floats, Floats]:
    """Return squared Mahalanobis distances (n, p) of the truth, and widths of the bars.

    d^T C^-1 d (n, p), d = e_j - y_j, of the truth y = a R x + t. It is placed in the
    image: a and t on x and y minimise sum_j ((e_j - y_j) / sd_j)^2, t on z takes the
    centroid of the depths to that of the estimate (why: docs/metrics.md). What this
    takes off the variance of x_j, its leverage h_j with the weights 1 / sd^2, is given
    back: d_x / sqrt(1 - h), as in studentised residuals.

    estimate e and deviation (n, 3, p) in the camera frame, truth x (n, 3, p), rotation
    R (n, 3, 3) from its frame there, correlation (n, 3, p) of x with y, x with z, y
    with z, or None for none. Returns squares (n, p), and the width (n, p) of the 90%
    ellipsoid, sqrt(q tr C / 3), in the unit of the truth. nan for landmarks that one
    side lacks, images with fewer than three, and those that no scale above 0 places.
    """
    visible = visible_in_both(estimate, truth)
    sd = deviation
    y = rotation @ np.where(visible[:, None], truth, 0.0)
    e = np.where(visible[:, None], estimate, 0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        weights = np.where(
            visible[:, None] & np.isfinite(sd), 1 / _raise_to_floor(sd), 0.0
        )
        weights = weights**2
        weights[:, 2] = visible  # depths: the centroid
        shares = weights / weights.sum(axis=2, keepdims=True)
        e = e - (shares * e).sum(axis=2, keepdims=True)
        y = y - (shares * y).sum(axis=2, keepdims=True)
        size = (weights * y**2)[:, :2].sum(axis=(1, 2))
        scale = (weights * e * y)[:, :2].sum(axis=(1, 2)) / size
        leverage = (shares + weights * y**2 / size[:, None, None])[:, :2]
        z = (e - scale[:, None, None] * y) / sd
        z[:, :2] /= np.sqrt(np.maximum(1 - leverage, MIN_VARIANCE_SHARE))
        square = mahalanobis(z, correlation)
        radius = np.sqrt(WIDTH_SQUARED_RADIUS * (sd**2).mean(axis=1))
        width = radius / scale[:, None]
    is_placed = (visible.sum(axis=1) >= MIN_COMMON_LANDMARKS) & (scale > 0)
    counts = visible & is_placed[:, None]
    counts &= np.isfinite(width) & ~np.isnan(square)
    return np.where(counts, square, np.nan), np.where(counts, width, np.nan)


def _raise_to_floor(sd: Floats) -> Floats:
    """Raise deviations `sd` (n, 3, p) to a tiny share of each image's largest."""
    largest = np.where(np.isfinite(sd), sd, 0.0).max(axis=(1, 2), keepdims=True)
    floored: Floats = np.maximum(sd, MIN_VARIANCE_SHARE * largest)
    return floored


def mahalanobis(z: Floats, correlation: Floats | None) -> Floats:
    """Return squared Mahalanobis distances (n, p) of errors in deviations z (n, 3, p).

    z^T K^-1 z, by elimination: x, then y given x, then z given both. K has the ones of
    a correlation matrix on its diagonal and correlation (n, 3, p) beside it, those of x
    with y, x with z, y with z; None for none.
    """
    if correlation is None:
        return np.asarray((z**2).sum(axis=1))
    x, y, depth = np.moveaxis(z, 1, 0)
    a, b, c = np.moveaxis(correlation, 1, 0)
    y_variance = np.maximum(1 - a**2, MIN_VARIANCE_SHARE)
    slope = (c - a * b) / y_variance
    depth_variance = 1 - b**2 - slope**2 * y_variance
    depth_variance = np.maximum(depth_variance, MIN_VARIANCE_SHARE)
    y_left = y - a * x
    depth_left = depth - b * x - slope * y_left
    return np.asarray(x**2 + y_left**2 / y_variance + depth_left**2 / depth_variance)


def summarise_coverage(
    method: str,
    bars: ErrorBars,
    sequences: Sequence[str],
    grouping: Mapping[str, Sequence[str]],
) -> Iterator[Coverage]:
    """Yield, for each group of sequences, how much of the truth error bars hold.

    sequences (n,): that of each image; grouping: group -> its sequences. Groups without
    error bars are left out.
    """
    names = np.array(sequences, dtype=str)
    for group, members in grouping.items():
        is_member = np.isin(names, list(members))
        square = bars.square[is_member]
        counted = int((~np.isnan(square)).sum())
        if not counted:
            continue
        yield {
            "method": method,
            "group": group,
            "counted": counted,
            "inside": [
                int((square <= radius).sum()) / counted
                for radius in SQUARED_RADII.values()
            ],
            "median_width": {
                unit: float(np.nanmedian(width[is_member]))
                for unit, width in bars.width.items()
            },
        }


def bar_scale_factors(bars: ErrorBars) -> dict[str, float | None]:
    """Return factors by which error bars must widen to hold what they state.

    One for each nominal share, such as "90%": sqrt(r / q) for the distance r that as
    many of the m landmarks do not exceed as split conformal prediction requires,
    ceil((m + 1) level), and the quantile q of chi^2. None where these are too few.
    """
    squares = np.sort(bars.square[~np.isnan(bars.square)])
    factors: dict[str, float | None] = {}
    for level, q in SQUARED_RADII.items():
        rank = math.ceil((len(squares) + 1) * level)
        factor = None
        if rank <= len(squares):
            # a little more, so that rounding leaves none of them out
            factor = math.sqrt(squares[rank - 1] / q) * (1 + 1e-9)
        factors[f"{100 * level:.0f}%"] = factor
    return factors
