"""Whether error bars are true: the share of the truth inside their ellipsoids, and
their width.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from shapefit.arrays import Floats
from shapefit.evaluation.metrics import FEWEST_LANDMARKS, visible_in_both

QUANTILES = {0.5: 2.3659738843753377, 0.9: 6.251388631170325}
"""Nominal share of the truth -> squared Mahalanobis radius: quantiles of chi^2 with 3
degrees.
"""
WIDTH_OF = 0.9
"""The ellipsoid whose width is reported, and that an image's share is of."""
QUANTILE = QUANTILES[WIDTH_OF]
SMALLEST = 1e-12
"""Share of a variance that is left where correlations leave none."""


class ErrorBars(NamedTuple):
    """The truth in the error bars of n images of one method.

    square (n, p): the squared Mahalanobis distance of the truth, chi^2 with 3 degrees
    of freedom where error bars are true; width (n, p): root of the mean squared
    semi-axis of the 90% ellipsoid, by unit. nan where there is no truth or no error
    bar.
    """

    square: Floats
    width: Mapping[str, Floats]

    def shares(self) -> Floats:
        """Share (n,) of the landmarks of each image inside the 90% ellipsoids; nan of
        none.
        """
        count = (~np.isnan(self.square)).sum(axis=1)
        inside, none = (
            (self.square <= QUANTILE).sum(axis=1),
            np.full(len(count), np.nan),
        )
        share: Floats = np.divide(inside, count, out=none, where=count > 0)
        return share


def find_squares(
    estimate: Floats,
    truth: Floats,
    rotation: Floats,
    deviation: Floats,
    correlation: Floats | None,
) -> tuple[Floats, Floats]:
    """d^T C^-1 d, d = e_j - y_j, of the truth y = a R x + t placed in the image; and
    the width.

    a and t on x and y minimise sum_j ((e_j - y_j) / sd_j)^2, t on z takes the centroid
    of the depths to that of the estimate (why: docs/metrics.md). What this takes off
    the variance of x_j, its leverage h_j with the weights 1 / sd^2, is given back: d_x
    / sqrt(1 - h), as in studentised residuals.

    estimate e and deviation (n, 3, p) in the camera frame, truth x (n, 3, p), rotation
    R (n, 3, 3) from its frame there, correlation (n, 3, p) of x with y, x with z, y
    with z, or None for none
    -> squares (n, p), and the width (n, p) of the 90% ellipsoid, sqrt(q tr C / 3), in
     the unit of
    the truth. nan for landmarks that one side lacks, images with fewer than three, and
        those that
    no scale above 0 places.
    """
    visible = visible_in_both(estimate, truth)
    y = rotation @ np.where(visible[:, None], truth, 0.0)
    e, sd = np.where(visible[:, None], estimate, 0.0), deviation
    least = SMALLEST * np.where(np.isfinite(sd), sd, 0.0).max(
        axis=(1, 2), keepdims=True
    )
    with np.errstate(divide="ignore", invalid="ignore"):
        weights = (
            np.where(visible[:, None] & np.isfinite(sd), 1 / np.maximum(sd, least), 0.0)
            ** 2
        )
        weights[:, 2] = visible  # depths: the centroid
        shares = weights / weights.sum(axis=2, keepdims=True)
        e, y = (
            points - (shares * points).sum(axis=2, keepdims=True) for points in (e, y)
        )
        size = (weights * y**2)[:, :2].sum(axis=(1, 2))
        scale = (weights * e * y)[:, :2].sum(axis=(1, 2)) / size
        leverage = (shares + weights * y**2 / size[:, None, None])[:, :2]
        z = (e - scale[:, None, None] * y) / sd
        z[:, :2] /= np.sqrt(np.maximum(1 - leverage, SMALLEST))
        square = mahalanobis(z, correlation)
        width = np.sqrt(QUANTILE * (sd**2).mean(axis=1)) / scale[:, None]
    counted = (
        visible
        & (visible.sum(axis=1) >= FEWEST_LANDMARKS)[:, None]
        & (scale > 0)[:, None]
    )
    counted &= np.isfinite(width) & ~np.isnan(square)
    return np.where(counted, square, np.nan), np.where(counted, width, np.nan)


def mahalanobis(z: Floats, correlation: Floats | None) -> Floats:
    """z^T K^-1 z for z (n, 3, p), by elimination: x, then y given x, then z given both.

    K has the ones of a correlation matrix on its diagonal and correlation (n, 3, p)
    beside it.
    """
    if correlation is None:
        return np.asarray((z**2).sum(axis=1))
    x, y, depth = np.moveaxis(z, 1, 0)
    a, b, c = np.moveaxis(correlation, 1, 0)
    of_y = np.maximum(1 - a**2, SMALLEST)
    tie = (c - a * b) / of_y
    of_depth = np.maximum(1 - b**2 - tie**2 * of_y, SMALLEST)
    rest = y - a * x
    return np.asarray(
        x**2 + rest**2 / of_y + (depth - b * x - tie * rest) ** 2 / of_depth
    )


def cover(
    method: str,
    bars: ErrorBars,
    sequences: Sequence[str],
    grouping: Mapping[str, Sequence[str]],
) -> Iterator[dict[str, Any]]:
    """Sum up the error bars of images of these sequences (n,), for each group that has
    any.

    counted landmarks; inside, the share of each of `QUANTILES`; median_width by unit.
    """
    names = np.array(sequences, dtype=str)
    for group, members in grouping.items():
        some = np.isin(names, list(members))
        square, row = bars.square[some], {"method": method, "group": group}
        if counted := int((~np.isnan(square)).sum()):
            inside = [int((square <= q).sum()) / counted for q in QUANTILES.values()]
            widths = {
                unit: float(np.nanmedian(w[some])) for unit, w in bars.width.items()
            }
            yield row | {"counted": counted, "inside": inside, "median_width": widths}


def bar_scale_factors(bars: ErrorBars) -> dict[str, float | None]:
    """Return how many times as wide error bars are true at each of `QUANTILES`, by its
    name.

    sqrt(r / q) for the distance r that as many of the m landmarks do not exceed as
    split conformal prediction requires, ceil((m + 1) level), and the quantile q of
    chi^2. None where these are too few.
    """
    squares = np.sort(bars.square[~np.isnan(bars.square)])
    factors: dict[str, float | None] = {}
    for level, q in QUANTILES.items():
        rank = math.ceil((len(squares) + 1) * level)
        # A little more, so that rounding leaves none of them out.
        enough = rank <= len(squares)
        factor = math.sqrt(squares[rank - 1] / q) * (1 + 1e-9) if enough else None
        factors[f"{100 * level:.0f}%"] = factor
    return factors
