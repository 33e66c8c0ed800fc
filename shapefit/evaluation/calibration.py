"""Whether error bars are true: the share of the truth inside their ellipsoids, and their width."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Floats
from shapefit.evaluation.metrics import FEWEST_LANDMARKS, visible_in_both
from shapefit.evaluation.summaries import labels_of

LEVELS = (0.5, 0.9)
"""Nominal shares of the truth inside the ellipsoids that are reported."""

WIDTH_OF = 0.9
"""The ellipsoid whose width is reported."""

QUANTILE = 6.251388631170325
"""Squared Mahalanobis radius of that ellipsoid: the 90% quantile of chi^2 with 3 degrees."""

INSIDE = f"inside_{100 * WIDTH_OF:.0f}"
"""What the share of an image is called."""

FARTHEST = math.exp(5)
"""Squared Mahalanobis distance beyond which no factor makes error bars true."""

SMALLEST = 1e-12
"""Share of a variance that is left where correlations leave none."""


@dataclass(frozen=True)
class ErrorBars:
    """The truth in the error bars of n images of one method.

    sequences (n); square (n, p): the squared Mahalanobis distance of the truth, chi^2 with 3
    degrees of freedom where error bars are true; width (n, p): root of the mean squared semi-axis
    of the 90% ellipsoid, by unit. nan where there is no truth or no error bar.
    """

    sequences: tuple[str, ...]
    square: Floats
    width: Mapping[str, Floats]


@dataclass(frozen=True)
class Coverage:
    """How often the truth of the landmarks of a group is inside the error bars.

    judged landmarks; inside, the share of each of `LEVELS`; the median width by unit. Every image
    of the group has the same weight.
    """

    method: str
    group: str
    judged: int
    inside: tuple[float, ...]
    median_width: Mapping[str, float]


def find_squares(
    estimate: Floats,
    truth: Floats,
    rotation: Floats,
    deviation: Floats,
    correlation: Floats | None,
) -> tuple[Floats, Floats]:
    """d^T C^-1 d, d = e_j - y_j, of the truth y = a R x + t placed in the image; and the width.

    a and t on x and y minimise sum_j ((e_j - y_j) / sd_j)^2, t on z takes the centroid of the
    depths to that of the estimate. Depths have no part in a: an error of a depth would become one
    of x and y, where the error bars are tight. What a placement with the weights w = 1 / sd^2 takes
    off the variance of x_j, its leverage h_j, is given back: d_x / sqrt(1 - h) (studentised
    residuals).

    estimate e and deviation (n, 3, p) in the camera frame, truth x (n, 3, p), rotation R (n, 3, 3)
    from its frame there, correlation (n, 3, p) of x with y, x with z, y with z, or None for none
    -> squares (n, p), and the width (n, p) of the 90% ellipsoid, sqrt(q tr C / 3), in the unit of
    the truth. nan for landmarks that one side lacks, images with fewer than three, and those that
    no scale above 0 places.
    """
    visible = visible_in_both(estimate, truth)
    y = rotation @ np.where(visible[:, None], truth, 0.0)
    e, sd = np.where(visible[:, None], estimate, 0.0), deviation
    least = SMALLEST * np.where(np.isfinite(sd), sd, 0.0).max(axis=(1, 2), keepdims=True)
    with np.errstate(divide="ignore", invalid="ignore"):
        weights = np.where(visible[:, None] & np.isfinite(sd), 1 / np.maximum(sd, least), 0.0) ** 2
        weights[:, 2] = visible  # depths: the centroid
        shares = weights / weights.sum(axis=2, keepdims=True)
        e, y = (each - (shares * each).sum(axis=2, keepdims=True) for each in (e, y))
        size = (weights * y**2)[:, :2].sum(axis=(1, 2))
        scale = (weights * e * y)[:, :2].sum(axis=(1, 2)) / size
        leverage = (shares + weights * y**2 / size[:, None, None])[:, :2]
        z = (e - scale[:, None, None] * y) / sd
        z[:, :2] /= np.sqrt(np.maximum(1 - leverage, SMALLEST))
        square = mahalanobis(z, correlation)
        width = np.sqrt(QUANTILE * (sd**2).mean(axis=1)) / scale[:, None]
    judged = visible & (visible.sum(axis=1) >= FEWEST_LANDMARKS)[:, None] & (scale > 0)[:, None]
    judged &= np.isfinite(width) & ~np.isnan(square)
    return np.where(judged, square, np.nan), np.where(judged, width, np.nan)


def mahalanobis(z: Floats, correlation: Floats | None) -> Floats:
    """z^T K^-1 z for z (n, 3, p), by elimination: x, then y given x, then z given both.

    K has the ones of a correlation matrix on its diagonal and correlation (n, 3, p) beside it.
    """
    if correlation is None:
        squares: Floats = (z**2).sum(axis=1)
        return squares
    x, y, depth = np.moveaxis(z, 1, 0)
    a, b, c = np.moveaxis(correlation, 1, 0)
    of_y = np.maximum(1 - a**2, SMALLEST)
    tie = (c - a * b) / of_y
    of_depth = np.maximum(1 - b**2 - tie**2 * of_y, SMALLEST)
    rest = y - a * x
    found: Floats = x**2 + rest**2 / of_y + (depth - b * x - tie * rest) ** 2 / of_depth
    return found


def quantile(level: float) -> float:
    """x with P(chi^2_3 <= x) = erf(sqrt(x / 2)) - sqrt(2 x / pi) exp(-x / 2) = level.

    By bisection, as SciPy takes longer to import.
    """
    if level == 1:
        return math.inf
    low, high = 0.0, 100.0
    while low < (x := (low + high) / 2) < high:
        below = math.erf(math.sqrt(x / 2)) - math.sqrt(2 * x / math.pi) * math.exp(-x / 2) < level
        low, high = (x, high) if below else (low, x)
    return high


def join_bars(parts: Sequence[ErrorBars]) -> ErrorBars:
    """Return the error bars of several files of one method."""
    most = max(part.square.shape[1] for part in parts)

    def joined(arrays: Iterable[Floats]) -> Floats:
        wide = [
            np.pad(values, ((0, 0), (0, most - values.shape[1])), constant_values=np.nan)
            for values in arrays
        ]
        return np.concatenate(wide)

    return ErrorBars(
        sequences=tuple(name for part in parts for name in part.sequences),
        square=joined(part.square for part in parts),
        width={unit: joined(part.width[unit] for part in parts) for unit in parts[0].width},
    )


def cover(
    method: str, bars: ErrorBars, grouping: Mapping[str, Sequence[str]]
) -> Iterator[Coverage]:
    """Sum up the error bars of the images of each group that has any."""
    labels = labels_of(bars.sequences)
    for group, members in grouping.items():
        rows = labels.among(members)
        square = bars.square[rows]
        judged = int((~np.isnan(square)).sum())
        if judged:
            inside = tuple(int((square <= quantile(level)).sum()) / judged for level in LEVELS)
            widths = {unit: _median(values[rows]) for unit, values in bars.width.items()}
            yield Coverage(method, group, judged, inside, widths)


def _median(widths: Floats) -> float:
    """Median of the widths that are known; nan of none.

    The two in the middle are cut to 12 bits behind the point, so that it is the same on every
    machine: the last bits of a width are not.
    """
    known = widths[~np.isnan(widths)]
    if not len(known):
        return math.nan
    places = [(len(known) - 1) // 2, len(known) // 2]
    middle = np.partition(known, places)[places].view(np.int64) >> 40
    return float(((middle << 40) + (1 << 39)).view(np.float64).mean())


def widening_factors(bars: ErrorBars) -> dict[str, float | None]:
    """Return how many times as wide error bars are true at each of `LEVELS`, by its name.

    sqrt(r / q) for the distance r that as many of the m landmarks do not exceed as split
    conformal prediction asks for, ceil((m + 1) level), and the quantile q of chi^2. None
    where these are too few, or lie beyond `FARTHEST`.
    """
    known = np.sort(bars.square[~np.isnan(bars.square)])
    found: dict[str, float | None] = {}
    for level in LEVELS:
        rank = math.ceil((len(known) + 1) * level)
        there = rank <= len(known) and known[rank - 1] <= FARTHEST
        # A little more, so that rounding leaves none of them out.
        factor = math.sqrt(known[rank - 1] / quantile(level)) * (1 + 1e-9) if there else None
        found[f"{100 * level:.0f}%"] = factor
    return found


def image_shares(bars: ErrorBars) -> tuple[NDArray[np.intp], Floats]:
    """Images of which a landmark can be judged, and the share of these inside the 90% ellipsoids.

    Returns rows (m,) and shares (m,).
    """
    judged = ~np.isnan(bars.square)
    rows = np.flatnonzero(judged.any(axis=1))
    return rows, (bars.square[rows] <= QUANTILE).sum(axis=1) / judged[rows].sum(axis=1)
