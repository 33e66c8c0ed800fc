"""Whether error bars are true: the share of the truth inside their ellipsoids, and their width."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Floats
from shapefit.evaluation.averages import mean
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
"""Squared Mahalanobis distances between which those of all landmarks are counted."""

TOGETHER = 1 << 15
"""Images whose error bars are added up together."""

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

    def take(self, rows: slice) -> ErrorBars:
        """Return those of some images."""
        return replace(
            self,
            items=self.items[rows],
            sequences=self.sequences[rows],
            level=self.level[rows],
            width={unit: values[rows] for unit, values in self.width.items()},
        )


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


class Coverages:
    """Adds up how the truth lies in the error bars of one method, group by group.

    parallel: whether those of any file are.

    Images are added up some thousand at a time, wherever one file ends and the next begins, so that
    results divided into files have the same sums to the last bit.
    """

    def __init__(self, groups: Mapping[str, str]) -> None:
        """Take the groups, name -> glob, as `group_sequences` does."""
        self.parallel = False
        self._groups = groups
        self._waiting: list[ErrorBars] = []
        self._sums: dict[str, dict[str | None, _Sums]] = {}
        self._curves: dict[str, NDArray[np.int64]] = {}
        self._squares = np.zeros(len(SQUARES) + 1, np.int64)

    def add(self, bars: ErrorBars) -> None:
        """Add the images of a file."""
        self.parallel |= bars.parallel
        self._waiting.append(bars)
        while sum(len(each.items) for each in self._waiting) >= TOGETHER:
            joined = join(self._waiting)
            self._waiting = [joined.take(slice(TOGETHER, None))]
            self._add_up(joined.take(slice(TOGETHER)))

    def cover(self, method: str, grouping: Mapping[str, Sequence[str]]) -> list[Coverage]:
        """Sum up each group: all its landmarks, then one by one; groups without any are left out.

        The groups are those of `grouping`, in its order.
        """
        if self._waiting:
            self._add_up(join(self._waiting))
            self._waiting = []
        return [
            sums.coverage(method, group, name)
            for group in grouping
            for name, sums in self._sums.get(group, {}).items()
            if self._sums[group][None].judged
        ]

    def curve(self, group: str) -> list[float]:
        """Share of the truth of a group inside the ellipsoid of each level of `CURVE`."""
        return [int(count) / self._sums[group][None].judged for count in self._curves[group]]

    def find_factors(self) -> dict[str, float | None]:
        """Return how many times as wide error bars are true at each of `LEVELS`, by its name.

        sqrt(r / q) for the distance r that as many of the m landmarks do not exceed as split
        conformal prediction asks for, ceil((m + 1) level), and the quantile q of chi^2. None
        where these are too few, or bars too narrow by more than 3 times.
        """
        from scipy.special import chdtri

        within, found = np.cumsum(self._squares), {}
        for nominal in LEVELS:
            wanted = np.ceil((within[-1] + 1) * nominal)
            at = int(np.searchsorted(within, wanted))
            there = at < len(SQUARES)
            q = chdtri(3.0, 1 - nominal)
            found[f"{100 * nominal:.0f}%"] = float(np.sqrt(SQUARES[at] / q)) if there else None
        return found

    def _add_up(self, bars: ErrorBars) -> None:
        from scipy.special import chdtri

        judged = bars.level[~np.isnan(bars.level)]
        places = np.searchsorted(SQUARES, chdtri(3.0, 1 - judged))
        self._squares += np.bincount(places, minlength=len(self._squares))
        for group, members in group_sequences(self._groups, filter(None, bars.sequences)).items():
            rows = of_sequences(bars, members)
            if not rows.any():
                continue
            level = bars.level[rows]
            width = {unit: values[rows] for unit, values in bars.width.items()}
            sums = self._sums.setdefault(group, {})
            columns: list[tuple[str | None, slice]] = [(None, slice(None))]
            columns += [(name, slice(j, j + 1)) for j, name in enumerate(bars.landmarks)]
            for name, column in columns:
                own = {unit: values[:, column] for unit, values in width.items()}
                sums.setdefault(name, _Sums()).add(level[:, column], own)
            counts = np.array([(level <= nominal).sum() for nominal in CURVE])
            self._curves[group] = self._curves.get(group, 0) + counts


@dataclass
class _Sums:
    """Landmarks that were judged, those inside each of `LEVELS`, and their widths, added up."""

    judged: int = 0
    inside: NDArray[np.int64] = field(default_factory=lambda: np.zeros(len(LEVELS), np.int64))
    width: dict[str, float] = field(default_factory=dict)

    def add(self, level: Floats, width: Mapping[str, Floats]) -> None:
        judged = ~np.isnan(level)
        self.judged += int(judged.sum())
        self.inside += [int((level <= nominal).sum()) for nominal in LEVELS]
        for unit, values in width.items():
            self.width[unit] = self.width.get(unit, 0.0) + float(values[judged].sum())

    def coverage(self, method: str, group: str, landmark: str | None) -> Coverage:
        n = self.judged
        shares = tuple(int(count) / n if n else float("nan") for count in self.inside)
        width = {unit: total / n if n else float("nan") for unit, total in self.width.items()}
        return Coverage(method, group, landmark, n, shares, width)


def image_shares(bars: ErrorBars) -> tuple[NDArray[np.intp], Floats]:
    """Images of which a landmark can be judged, and the share of these inside the 90% ellipsoids.

    Returns rows (m,) and shares (m,).
    """
    judged = ~np.isnan(bars.level)
    rows = np.flatnonzero(judged.any(axis=1))
    return rows, (bars.level[rows] <= WIDTH_OF).sum(axis=1) / judged[rows].sum(axis=1)


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
        left_out = int(LEAST_TRUSTED * len(rows))
        rising = rows[np.argsort(trust[rows], kind="stable")]
        kept = np.sort(rising[left_out:])
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
                plausibility=float(trust[rising[left_out]]),
            )
        )
    return found
