"""Whether error bars are true: the share of the truth inside their ellipsoids, and their width."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from shapefit.evaluation.metric_table import SHARE
from shapefit.evaluation.metrics import FEWEST_LANDMARKS, placed_apart, visible_in_both
from shapefit.evaluation.summary import ImageErrors

Floats = NDArray[np.float64]

LEVELS = (0.5, 0.9)
"""Nominal shares of the truth inside the ellipsoids that are reported."""

WIDTH_OF = 0.9
"""The ellipsoid whose width is reported."""

QUANTILE = 6.251388631170325
"""Squared Mahalanobis radius of that ellipsoid: the 90% quantile of chi^2 with 3 degrees."""

INSIDE = f"inside_{100 * WIDTH_OF:.0f}"
"""What the share of an image is called."""

SMALLEST = 1e-12
"""Share of a variance that is left where correlations leave none."""


@dataclass(frozen=True)
class ErrorBars:
    """The truth in the error bars of n images of one method.

    level (n, p): the nominal level of the ellipsoid on which the truth lies, uniform from 0 to 1
    where error bars are true; width (n, p): root of the mean squared semi-axis of the 90%
    ellipsoid, by unit. nan where there is no truth or no error bar. parallel: without
    correlations, so that the ellipsoids are parallel to the axes of the camera.
    """

    method: str
    landmarks: tuple[str, ...]
    items: tuple[str, ...]
    sequences: tuple[str, ...]
    level: Floats
    width: Mapping[str, Floats]
    parallel: bool


@dataclass(frozen=True)
class Coverage:
    """How often the truth of one landmark of a group, or of all (`landmark` None), is inside.

    judged landmarks; inside, the share of each of `LEVELS`; the mean width by unit. Every image of
    the group has the same weight.
    """

    method: str
    group: str
    landmark: str | None
    judged: int
    inside: tuple[float, ...]
    width: Mapping[str, float]


def find_levels(
    estimate: Floats, truth: Floats, deviation: Floats, correlation: Floats | None
) -> tuple[Floats, Floats]:
    """P(chi^2_3 < d^T C^-1 d), d = e_j - (y_j - t) / s with s, t of the metric `camera`; and width.

    estimate e, truth y, deviation (n, 3, p) in the camera frame, correlation (n, 3, p) of x with
    y, x with z, y with z, or None for none -> level (n, p), and the width (n, p) of the 90%
    ellipsoid, sqrt(q tr C / 3), in the unit of the truth. nan for landmarks that one side lacks,
    images with fewer than three, and those that s shrinks to a point.
    """
    apart, scale = placed_apart(estimate, truth)
    visible = visible_in_both(estimate, truth)
    judged = visible & (visible.sum(axis=1) >= FEWEST_LANDMARKS)[:, None] & (scale > 0)[:, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        z = apart / (scale[:, None, None] * deviation)
        square = mahalanobis(z, correlation)
    width = scale[:, None] * np.sqrt(QUANTILE * (deviation**2).mean(axis=1))
    judged &= np.isfinite(width) & ~np.isnan(square)
    return np.where(judged, cumulative(square), np.nan), np.where(judged, width, np.nan)


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


def cumulative(square: Floats) -> Floats:
    """P(chi^2 < square) with 3 degrees of freedom."""
    from scipy.special import chdtr

    level: Floats = chdtr(3.0, square)
    return level


def inside(level: Floats, nominal: Sequence[float]) -> tuple[float, ...]:
    """Share of the levels, nan left out, within each nominal one; nan where there are none."""
    known = level[~np.isnan(level)]
    if not len(known):
        return (float("nan"),) * len(nominal)
    return tuple(float((known <= each).mean()) for each in nominal)


def cover(bars: ErrorBars, grouping: Mapping[str, Sequence[str]]) -> list[Coverage]:
    """Sum up each group: all its landmarks, then one by one; groups without any are left out."""
    found = []
    for group, members in grouping.items():
        rows = of_sequences(bars, members)
        level = bars.level[rows]
        if np.isnan(level).all():
            continue
        columns: list[tuple[str | None, slice]] = [(None, slice(None))]
        columns += [(name, slice(j, j + 1)) for j, name in enumerate(bars.landmarks)]
        for name, column in columns:
            judged = ~np.isnan(level[:, column])
            width = {
                unit: float(values[rows][:, column][judged].mean()) if judged.any() else np.nan
                for unit, values in bars.width.items()
            }
            shares = inside(level[:, column], LEVELS)
            found.append(Coverage(bars.method, group, name, int(judged.sum()), shares, width))
    return found


def image_shares(bars: ErrorBars) -> ImageErrors:
    """Share of the landmarks of each image inside the 90% ellipsoids, where any can be judged."""
    judged = ~np.isnan(bars.level)
    rows = np.flatnonzero(judged.any(axis=1))
    within = (bars.level[rows] <= WIDTH_OF).sum(axis=1) / judged[rows].sum(axis=1)
    items, sequences = (tuple(names[row] for row in rows) for names in (bars.items, bars.sequences))
    return ImageErrors(bars.method, INSIDE, SHARE, items, sequences, within)


def of_sequences(bars: ErrorBars, members: Sequence[str]) -> NDArray[np.bool_]:
    """Which images (n,) belong to the sequences."""
    return np.isin(np.array(bars.sequences, dtype=str), np.array(members, dtype=str))


def join(parts: Sequence[ErrorBars]) -> ErrorBars:
    """Join the files of one method; a landmark that a file lacks is nan in its images."""
    names = tuple(dict.fromkeys(name for part in parts for name in part.landmarks))

    def arranged(part: ErrorBars, values: Floats) -> Floats:
        whole = np.full((len(values), len(names)), np.nan)
        whole[:, [names.index(name) for name in part.landmarks]] = values
        return whole

    return ErrorBars(
        method=parts[0].method,
        landmarks=names,
        items=tuple(item for part in parts for item in part.items),
        sequences=tuple(sequence for part in parts for sequence in part.sequences),
        level=np.concatenate([arranged(part, part.level) for part in parts]),
        width={
            unit: np.concatenate([arranged(part, part.width[unit]) for part in parts])
            for unit in parts[0].width
        },
        parallel=any(part.parallel for part in parts),
    )
