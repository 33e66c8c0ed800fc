"""Error bars and plausibilities as a part of the page: how true they are."""

from __future__ import annotations

import math
from collections.abc import Sequence

from shapefit.errors import listed
from shapefit.evaluation.calibration import LEAST_TRUSTED, LEVELS, WIDTH_OF, Coverage, Kept
from shapefit.evaluation.report import Report
from shapefit.evaluation.summary import ALL
from shapefit.evaluation.tables.document import ABSENT, Block, Section, Table, decimals_of, number

SHARES = [f"{level:.0%}" for level in LEVELS]

_HOW_TO_READ = (
    f"Share of the landmarks whose truth is inside the {' and '.join(SHARES)} ellipsoids of the "
    "error bars, the truth placed by scale and translation as in the metric `camera`. Wide bars "
    f"hold anything, so their width stands beside: the mean of the {WIDTH_OF:.0%} ellipsoids' root "
    "mean squared semi-axes. Every image has the same weight."
)
_BY_LANDMARK = f"Landmark by landmark, {' / '.join(SHARES)} / width ({{unit}}):"
_TRUST = (
    f"Mean error of all images, and of those kept when the {LEAST_TRUSTED:.0%} with the least "
    "plausibility of each group are left out. Every image has the same weight, so the first may "
    "differ from the mean over sequences."
)


def calibration(report: Report) -> list[Block]:
    """Return the sections on error bars and plausibilities; none where no method has them."""
    parts: list[Block] = []
    if report.coverage:
        parts += [Section("Error bars"), " ".join([_HOW_TO_READ, *_exceptions(report)])]
        parts += [_by_group(report.coverage), *_by_landmark(report.coverage)]
    if report.kept:
        parts += [Section("Least plausible images"), _TRUST, _trust(report.kept)]
    return parts


def _exceptions(report: Report) -> list[str]:
    """Sentences about the methods without error bars, and those without correlations."""
    found = []
    if report.without_bars:
        found.append(f"Without error bars, and left out: {listed(report.without_bars, 'and')}.")
    if report.parallel:
        found.append(
            f"The ellipsoids of {listed(report.parallel, 'and')} are parallel to the axes, as the "
            "results hold `shape_sd` without `shape_correlation`."
        )
    return found


def _by_group(coverage: Sequence[Coverage]) -> Table:
    whole = [c for c in coverage if c.landmark is None]
    units = list(dict.fromkeys(unit for c in whole for unit in c.width))
    grouped = {c.group for c in whole} != {ALL}
    decimals = {
        unit: decimals_of(c.width[unit] for c in whole if unit in c.width) for unit in units
    }
    header = ["method", *(["group"] if grouped else []), "landmarks", *SHARES]
    header += [f"width ({unit})" for unit in units]
    rows = [
        [
            c.method,
            *([c.group] if grouped else []),
            str(c.judged),
            *map(_share, c.inside),
            *(number(c.width.get(unit), decimals[unit]) for unit in units),
        ]
        for c in whole
    ]
    return Table(header, rows)


def _by_landmark(coverage: Sequence[Coverage]) -> list[Block]:
    """One table, landmarks down, methods and groups across."""
    single = {(c.method, c.group, c.landmark): c for c in coverage if c.landmark is not None}
    columns = list(dict.fromkeys((method, group) for method, group, _ in single))
    landmarks = list(dict.fromkeys(str(landmark) for *_, landmark in single))
    (unit, *_) = next(iter(single.values())).width
    decimals = decimals_of(c.width[unit] for c in single.values())

    def cell(c: Coverage | None) -> str:
        if c is None or not c.judged:
            return ABSENT
        return " / ".join([*map(_share, c.inside), number(c.width[unit], decimals)])

    header = ["", *(m if g == ALL else f"{m}, {g}" for m, g in columns)]
    rows = [
        [name, *(cell(single.get((*column, name))) for column in columns)] for name in landmarks
    ]
    return [_BY_LANDMARK.format(unit=unit), Table(header, rows)]


def _trust(kept: Sequence[Kept]) -> Table:
    """The first metric and unit of each method."""
    first: dict[str, tuple[str, str]] = {}
    for k in kept:
        first.setdefault(k.method, (k.metric, k.unit))
    shown = [k for k in kept if first[k.method] == (k.metric, k.unit)]
    grouped = {k.group for k in shown} != {ALL}
    decimals = decimals_of(k.mean for k in shown)
    header = ["method", *(["group"] if grouped else []), "metric", "images", "error"]
    header += ["kept", "error of the kept", "plausibility from"]
    rows = [
        [
            k.method,
            *([k.group] if grouped else []),
            f"{k.metric} ({k.unit})",
            str(k.images),
            number(k.mean, decimals),
            str(k.kept),
            number(k.mean_kept, decimals),
            f"{k.plausibility:.2g}",
        ]
        for k in shown
    ]
    return Table(header, rows)


def _share(share: float) -> str:
    return ABSENT if math.isnan(share) else f"{100 * share:.1f} %"
