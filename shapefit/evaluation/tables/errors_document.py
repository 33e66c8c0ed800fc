"""An evaluation as a document: errors, counts, how the fits went, and what to bear in mind."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from shapefit.errors import listed
from shapefit.evaluation.calibration import LEAST_TRUSTED, LEVELS, WIDTH_OF, Coverage, Kept
from shapefit.evaluation.report import PUBLISHED, Report, Solving
from shapefit.evaluation.summary import ALL, Summary
from shapefit.evaluation.tables.csv_json import by_kind
from shapefit.evaluation.tables.document import (
    ABSENT,
    HOW_TO_READ_PAIRS,
    Block,
    Italic,
    Listing,
    Section,
    Table,
    Title,
    as_markdown,
    decimals_of,
    number,
    pairs,
    percent,
)

Kind = tuple[str, str]

FAILURES_SHOWN = 10
"""Failed items that the page lists per method; the JSON lists them all."""

_SPEED = ("ms per image", "images/s")

_HOW_TO_READ = "Each number is the mean, over the sequences of the group, of the sequence's mean."
_HOW_TO_READ_OVERVIEW = f"{HOW_TO_READ_PAIRS} Times are those of solving alone."
_HOW_TO_READ_SOLVING = (
    "Means over all images, as reported by the result files. Objectives of different models cannot "
    "be compared: the convex program, the methods with one rotation (convex+refine, alternate), "
    "pmp and mean-shape minimise different functions, and all depend on lambda and the dictionary. "
    "Times are those of the machine and the threads of each fit, for solving alone."
)
_QUOTED = "Figures in italics are quoted from publications, not computed here."


def markdown(report: Report) -> str:
    """Return the page as Markdown."""
    return as_markdown(document(report))


def document(report: Report, failures: int = FAILURES_SHOWN) -> list[Block]:
    """Return the blocks of the page, with so many failed items per method.

    Groups have a table per metric and unit, groups down and methods across. Without groups there is
    one table, methods down, and the means and medians of all metrics across.
    """
    tables = by_kind(summary for summary in report.summaries if summary.sequence is None)
    groups = {group for quoted in report.published.values() for group in quoted}
    groups |= {summary.group for summary in report.summaries}
    parts: list[Block] = [Title("Errors against the truth")]
    if groups == {ALL}:
        parts.append(_HOW_TO_READ_OVERVIEW)
    else:
        parts.append(_HOW_TO_READ)
    if report.published and PUBLISHED in tables:
        parts.append(_QUOTED)
    if groups == {ALL}:
        parts.append(_overview(report, tables))
    else:
        for kind, summaries in tables.items():
            published = report.published if kind == PUBLISHED else {}
            parts += [Section(f"{kind[0]} ({kind[1]})"), _errors_table(summaries, published)]
    parts += calibration(report)
    parts += [Section("Images"), _images_table(report), *_failed_items(report, failures)]
    parts += _solving(report)
    parts += _listing("Left out", report.warnings)
    parts += _listing("Caveats", report.caveats)
    return parts


def _overview(report: Report, tables: Mapping[Kind, Sequence[Summary]]) -> Table:
    """Methods down; mean and median of every metric and unit, then the speed, across.

    A quoted method, in italics, has one mean only.
    """
    methods = dict.fromkeys(s.method for summaries in tables.values() for s in summaries)
    header, columns = ["method"], []
    for kind, summaries in tables.items():
        header.append(f"{kind[0]} ({kind[1]})")
        columns.append(dict(zip([s.method for s in summaries], pairs(summaries), strict=True)))
    solving = {method.name: method.solving for method in report.methods}
    if any(s.milliseconds is not None for s in solving.values()):
        header += _SPEED
        speeds = {name: _speed(of) for name, of in solving.items()}
        columns += [{name: cells[i] for name, cells in speeds.items()} for i in range(len(_SPEED))]
    rows = [[name, *(column.get(name, ABSENT) for column in columns)] for name in methods]
    if PUBLISHED in tables:
        place = list(tables).index(PUBLISHED)
        for name, quoted in report.published.items():
            cells = [ABSENT] * len(columns)
            cells[place] = number(quoted[ALL], decimals_of([quoted[ALL]]))
            rows.append([Italic(name), *cells])
    return Table(header, rows)


def _errors_table(
    summaries: Sequence[Summary], published: Mapping[str, Mapping[str, float]]
) -> Table:
    ours = {(s.group, s.method): s.mean for s in summaries}
    quoted = {(g, m): error for m, column in published.items() for g, error in column.items()}
    groups = dict.fromkeys(group for group, _ in (*ours, *quoted))
    methods = dict.fromkeys(method for _, method in ours)
    decimals = decimals_of([*ours.values(), *quoted.values()])

    header = ["", *methods, *(Italic(method) for method in published)]
    rows = [
        [
            group,
            *(number(ours.get((group, method)), decimals) for method in methods),
            *(number(quoted.get((group, method)), decimals) for method in published),
        ]
        for group in groups
    ]
    return Table(header, rows)


def _images_table(report: Report) -> Table:
    counts = [(m.name, m.images, m.failed) for m in report.methods]
    rows = [[name, str(n - failed), str(failed)] for name, n, failed in counts]
    return Table(["method", "evaluated", "failed"], rows)


def _solving(report: Report) -> list[Block]:
    """The table of what the fits report; empty for results that report nothing, as in CSV."""
    told = [(method.name, method.solving) for method in report.methods]
    if all(solving == Solving() for _, solving in told):
        return []
    decimals = decimals_of(s.mean_objective for _, s in told if s.mean_objective is not None)
    header = ["method", "mean objective", *_SPEED, "optimal or converged"]
    rows = [
        [
            name,
            number(s.mean_objective, decimals),
            *_speed(s),
            ABSENT if s.solved is None else percent(s.solved, 2),
        ]
        for name, s in told
    ]
    return [Section("Solving"), _HOW_TO_READ_SOLVING, Table(header, rows)]


def _speed(solving: Solving) -> list[str]:
    """Cells of `_SPEED`; from 100 images per second on whole ones."""
    rate = solving.images_per_second
    return [
        ABSENT if solving.milliseconds is None else f"{solving.milliseconds:.3g}",
        ABSENT if rate is None else f"{rate:.0f}" if rate >= 100 else f"{rate:.3g}",
    ]


def _failed_items(report: Report, most: int) -> list[Block]:
    lines = []
    for method in report.methods:
        failures = list(method.failures.items())
        lines += [f"{method.name}, {item}: {why}" for item, why in failures[:most]]
        if method.failed > most:
            more = method.failed - most
            listed = f"the first {len(failures):,}" if method.unlisted else "all"
            lines.append(f"{method.name}: {more} more, {listed} listed in report.json")
    return _listing("Failed", lines)


def _listing(title: str, lines: Sequence[str]) -> list[Block]:
    return [Section(title), Listing(lines)] if lines else []


SHARES = [f"{level:.0%}" for level in LEVELS]

_HOW_TO_READ_BARS = (
    f"Share of the landmarks whose truth is inside the {' and '.join(SHARES)} ellipsoids of the "
    "error bars, the truth placed by scale and translation as in the metric `camera`. Wide bars "
    f"hold anything, so their width stands beside: the median of the {WIDTH_OF:.0%} ellipsoids' "
    "root mean squared semi-axes. Every image has the same weight."
)
_BY_LANDMARK = f"Landmark by landmark, {' / '.join(SHARES)} / median width ({{unit}}):"
_TRUST = (
    f"Mean error of all images, and of those kept when the {LEAST_TRUSTED:.0%} with the least "
    "plausibility of each group are left out. Every image has the same weight, so the first may "
    "differ from the mean over sequences."
)


def calibration(report: Report) -> list[Block]:
    """Return the sections on error bars and plausibilities; none where no method has them."""
    parts: list[Block] = []
    if report.coverage:
        parts += [Section("Error bars"), " ".join([_HOW_TO_READ_BARS, *_exceptions(report)])]
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
    units = list(dict.fromkeys(unit for c in whole for unit in c.median_width))
    grouped = {c.group for c in whole} != {ALL}
    decimals = {
        unit: decimals_of(c.median_width[unit] for c in whole if unit in c.median_width)
        for unit in units
    }
    header = ["method", *(["group"] if grouped else []), "landmarks", *SHARES]
    header += [f"median width ({unit})" for unit in units]
    rows = [
        [
            c.method,
            *([c.group] if grouped else []),
            str(c.judged),
            *map(_share, c.inside),
            *(number(c.median_width.get(unit), decimals[unit]) for unit in units),
        ]
        for c in whole
    ]
    return Table(header, rows)


def _by_landmark(coverage: Sequence[Coverage]) -> list[Block]:
    """One table, landmarks down, methods and groups across."""
    single = {(c.method, c.group, c.landmark): c for c in coverage if c.landmark is not None}
    columns = list(dict.fromkeys((method, group) for method, group, _ in single))
    landmarks = list(dict.fromkeys(str(landmark) for *_, landmark in single))
    (unit, *_) = next(iter(single.values())).median_width
    decimals = decimals_of(c.median_width[unit] for c in single.values())

    def cell(c: Coverage | None) -> str:
        if c is None or not c.judged:
            return ABSENT
        return " / ".join([*map(_share, c.inside), number(c.median_width[unit], decimals)])

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
