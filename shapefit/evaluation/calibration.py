"""Whether error bars are true: the share of the truth inside their ellipsoids, and their width."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Floats
from shapefit.evaluation.averages import labels_of, mean
from shapefit.evaluation.metrics import FEWEST_LANDMARKS, placed_apart, visible_in_both
from shapefit.evaluation.summary import ImageErrors, group_sequences

LEVELS = (0.5, 0.9)
"""Nominal shares of the truth inside the ellipsoids that are reported."""

WIDTH_OF = 0.9
"""The ellipsoid whose width is reported."""

QUANTILE = 6.251388631170325
"""Squared Mahalanobis radius of that ellipsoid: the 90% quantile of chi^2 with 3 degrees."""

INSIDE = f"inside_{100 * WIDTH_OF:.0f}"
"""What the share of an image is called."""

CURVE = tuple(np.linspace(0, 1, 41).tolist())
"""Nominal levels at which the share of all landmarks is drawn."""

SQUARES = np.exp(np.linspace(-14, 5, 3801))
"""Squared Mahalanobis distances up to which landmarks are counted, beside those of the levels."""

BELOW = 40
"""Last bits of a width that are left out where widths are counted: an eight-thousandth of it."""

SMALLEST = 1e-12
"""Share of a variance that is left where correlations leave none."""


@dataclass(frozen=True)
class ErrorBars:
    """The truth in the error bars of n images of one method, in one of its files.

    square (n, p): the squared Mahalanobis distance of the truth, chi^2 with 3 degrees of freedom
    where error bars are true; width (n, p): root of the mean squared semi-axis of the 90%
    ellipsoid, by unit. nan where there is no truth or no error bar. parallel: without
    correlations, so that the ellipsoids are parallel to the axes of the camera.
    """

    landmarks: tuple[str, ...]
    sequences: tuple[str, ...]
    square: Floats
    width: Mapping[str, Floats]
    parallel: bool


@dataclass(frozen=True)
class Coverage:
    """How often the truth of one landmark of a group, or of all (`landmark` None), is inside.

    judged landmarks; inside, the share of each of `LEVELS`; the median width by unit, to four
    digits. Every image of the group has the same weight.
    """

    method: str
    group: str
    landmark: str | None
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
    """d^T C^-1 d, d = e_j - (R x_j - t) / s with s, t of the metric `camera`; and the width.

    estimate e and deviation (n, 3, p) in the camera frame, truth x (n, 3, p), rotation R (n, 3, 3)
    from its frame there, correlation (n, 3, p) of x with y, x with z, y with z, or None for none
    -> squares (n, p), and the width (n, p) of the 90% ellipsoid, sqrt(q tr C / 3), in the unit of
    the truth. nan for landmarks that one side lacks, images with fewer than three, and those that
    s shrinks to a point.
    """
    apart, scale, _ = placed_apart(estimate, truth, rotation)
    visible = visible_in_both(estimate, truth)
    judged = visible & (visible.sum(axis=1) >= FEWEST_LANDMARKS)[:, None] & (scale > 0)[:, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        z = apart / (scale[:, None, None] * deviation)
        square = mahalanobis(z, correlation)
    width = scale[:, None] * np.sqrt(QUANTILE * (deviation**2).mean(axis=1))
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


class _Radii(NamedTuple):
    """Squared radii up to which landmarks are counted, the last infinite; the places of some."""

    all: Floats
    of_levels: NDArray[np.intp]
    of_curve: NDArray[np.intp]
    of_squares: NDArray[np.intp]


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


@cache
def _radii() -> _Radii:
    parts = [*(np.array([*map(quantile, nominal)]) for nominal in (LEVELS, CURVE)), SQUARES]
    radii = np.unique(np.concatenate(parts))
    return _Radii(radii, *(np.searchsorted(radii, part) for part in parts))


class _Counts:
    """Landmarks by the squared distance of the truth, and by width in a unit."""

    def __init__(self) -> None:
        self.within = np.zeros(len(_radii().all), np.int64)
        self.widths: dict[str, tuple[NDArray[np.int64], NDArray[np.int64]]] = {}

    @classmethod
    def of(cls, square: Floats, width: Mapping[str, Floats]) -> _Counts:
        """Count those of one landmark (n,)."""
        counts = cls()
        counts.within = np.searchsorted(np.sort(square), _radii().all, side="right")
        for unit, values in width.items():
            leading = values[~np.isnan(values)].view(np.int64) >> BELOW
            counts.widths[unit] = np.unique(leading, return_counts=True)
        return counts

    def add(self, other: _Counts) -> None:
        """Add the landmarks of other counts."""
        self.within = self.within + other.within
        for unit, own in other.widths.items():
            both = (own, self.widths.get(unit, (own[0][:0], own[1][:0])))
            leading, counts = map(np.concatenate, zip(*both, strict=True))
            found, places = np.unique(leading, return_inverse=True)
            self.widths[unit] = found, np.bincount(places, counts, len(found)).astype(np.int64)

    def median_width(self, unit: str) -> float:
        """Return the median width in a unit; nan of none."""
        leading, counts = self.widths[unit]
        within = np.cumsum(counts)
        if not len(within):
            return float("nan")
        middle = np.searchsorted(within, [(within[-1] - 1) // 2, within[-1] // 2], side="right")
        return float(((leading[middle] << BELOW) + (1 << BELOW - 1)).view(np.float64).mean())


class Coverages:
    """Counts how the truth lies in the error bars of one method, group by group.

    parallel: whether those of any file are. Counts do not depend on how results are divided into
    files.
    """

    def __init__(self, groups: Mapping[str, str]) -> None:
        """Take the groups, name -> glob, as `group_sequences` does."""
        self.parallel = False
        self._groups = groups
        self._every: dict[str, _Counts] = {}
        self._counts: dict[str, dict[str, _Counts]] = {}

    def add(self, bars: ErrorBars) -> None:
        """Add the images of a file."""
        self.parallel |= bars.parallel
        sequences = labels_of(bars.sequences)
        every = _count(bars, slice(None))
        _add(self._every, every)
        for group, members in group_sequences(self._groups, filter(None, sequences.names)).items():
            rows = sequences.among(members)
            if rows.any():
                own = every if rows.all() else _count(bars, rows)
                _add(self._counts.setdefault(group, {}), own)

    def cover(self, method: str, grouping: Mapping[str, Sequence[str]]) -> list[Coverage]:
        """Sum up each group: all its landmarks, then one by one; groups without any are left out.

        The groups are those of `grouping`, in its order.
        """
        found = []
        for group in grouping:
            counts = self._counts.get(group, {})
            whole = _sum(counts.values())
            if whole.within[-1]:
                found.append(_coverage(whole, method, group, None))
                found += [_coverage(own, method, group, name) for name, own in counts.items()]
        return found

    def curve(self, group: str) -> list[float]:
        """Share of the truth of a group inside the ellipsoid of each level of `CURVE`."""
        within = _sum(self._counts[group].values()).within
        return [int(count) / int(within[-1]) for count in within[_radii().of_curve]]

    def find_factors(self) -> dict[str, float | None]:
        """Return how many times as wide error bars are true at each of `LEVELS`, by its name.

        sqrt(r / q) for the distance r that as many of the m landmarks do not exceed as split
        conformal prediction asks for, ceil((m + 1) level), and the quantile q of chi^2. None
        where these are too few, or bars too narrow by more than 3 times.
        """
        radii, found = _radii(), {}
        every = _sum(self._every.values()).within
        for nominal, q in zip(LEVELS, radii.all[radii.of_levels], strict=True):
            wanted = np.ceil((every[-1] + 1) * nominal)
            at = int(np.searchsorted(every[radii.of_squares], wanted))
            there = at < len(SQUARES)
            found[f"{100 * nominal:.0f}%"] = float(np.sqrt(SQUARES[at] / q)) if there else None
        return found


def _count(bars: ErrorBars, rows: NDArray[np.bool_] | slice) -> dict[str, _Counts]:
    """Count the landmarks of some images, by name."""
    square = bars.square[rows].T
    width = {unit: values[rows].T for unit, values in bars.width.items()}
    return {
        name: _Counts.of(square[j], {unit: values[j] for unit, values in width.items()})
        for j, name in enumerate(bars.landmarks)
    }


def _add(counts: dict[str, _Counts], further: Mapping[str, _Counts]) -> None:
    for name, own in further.items():
        counts.setdefault(name, _Counts()).add(own)


def _sum(parts: Iterable[_Counts]) -> _Counts:
    total = _Counts()
    for part in parts:
        total.add(part)
    return total


def _coverage(counts: _Counts, method: str, group: str, landmark: str | None) -> Coverage:
    n = int(counts.within[-1])
    inside = counts.within[_radii().of_levels].tolist()
    shares = tuple(count / n if n else float("nan") for count in inside)
    width = {unit: counts.median_width(unit) for unit in counts.widths}
    return Coverage(method, group, landmark, n, shares, width)


def image_shares(bars: ErrorBars) -> tuple[NDArray[np.intp], Floats]:
    """Images of which a landmark can be judged, and the share of these inside the 90% ellipsoids.

    Returns rows (m,) and shares (m,).
    """
    judged = ~np.isnan(bars.square)
    rows = np.flatnonzero(judged.any(axis=1))
    return rows, (bars.square[rows] <= QUANTILE).sum(axis=1) / judged[rows].sum(axis=1)


LEAST_TRUSTED = 0.1
"""Share of the images of a group that is left out, the least plausible ones."""


@dataclass(frozen=True)
class Kept:
    """Mean error over the images of a group, and over those that are kept.

    Every image has the same weight. `plausibility` is the least that was kept.
    """

    method: str
    metric: str
    unit: str
    group: str
    images: int
    mean: float
    kept: int
    mean_kept: float
    plausibility: float


def keep_trusted(errors: ImageErrors, grouping: Mapping[str, Sequence[str]]) -> list[Kept]:
    """Leave out the least plausible tenth of each group, rounded down; ties by order of images.

    Images without an error or a plausibility do not count, nor do groups without any other.
    """
    if errors.plausibility is None:
        return []
    values, trust = errors.values[:], errors.plausibility[:]
    both = ~np.isnan(values) & ~np.isnan(trust)
    found = []
    for group, members in grouping.items():
        rows = np.flatnonzero(errors.sequences.among(members) & both)
        if not len(rows):
            continue
        left_out, own = int(LEAST_TRUSTED * len(rows)), trust[rows]
        least = np.partition(own, left_out)[left_out]
        out = own < least
        out[np.flatnonzero(own == least)[: left_out - out.sum()]] = True
        kept = rows[~out]
        found.append(
            Kept(
                method=errors.method,
                metric=errors.metric,
                unit=errors.unit,
                group=group,
                images=len(rows),
                mean=mean(values[rows]),
                kept=len(kept),
                mean_kept=mean(values[kept]),
                plausibility=float(least),
            )
        )
    return found
