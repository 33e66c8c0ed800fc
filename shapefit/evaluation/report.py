"""The report of an evaluation: all its numbers, as CSV, as JSON, and as a page of Markdown."""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any, TypeVar

import numpy as np
import orjson

from shapefit.arrays import Floats
from shapefit.errors import listed
from shapefit.evaluation.calibration import LEVELS, WIDTH_OF, Coverage
from shapefit.evaluation.summaries import (
    ALL,
    LEAST_TRUSTED,
    ImageErrors,
    Kept,
    Kind,
    Summary,
)
from shapefit.geometry.normalisation import LARGEST

MOST_LISTED = 10_000
"""Failed images of a method that are listed with their reasons; more are counted."""


@dataclass(frozen=True)
class Run:
    """What a result file says about the fit of n images, None where it says nothing.

    objective (n), nan where an image failed; solved, how many are optimal or converged; seconds for
    all images.
    """

    images: int
    objective: Floats | None = None
    solved: int | None = None
    seconds: float | None = None


@dataclass(frozen=True)
class Solving:
    """How one method solved its images; None where not all of its files say it.

    Mean objective over the images that have one, milliseconds per image, and the share of images
    that are optimal or converged.
    """

    mean_objective: float | None = None
    milliseconds: float | None = None
    solved: float | None = None

    @property
    def images_per_second(self) -> float | None:
        """1000 / milliseconds; None where that is unknown or too short to measure."""
        return 1000 / self.milliseconds if self.milliseconds else None


@dataclass(frozen=True)
class Method:
    """One method that was judged: where its results lie, how many images, and which failed.

    `failures` maps an item to the reason; `unlisted` images failed, too, beyond those that are
    listed; `solving` sums up how the fit went.
    """

    name: str
    files: tuple[str, ...]
    images: int
    failures: Mapping[str, str]
    solving: Solving = field(default_factory=Solving)
    unlisted: int = 0

    @property
    def failed(self) -> int:
        """Number of images that failed."""
        return len(self.failures) + self.unlisted


@dataclass(frozen=True)
class Report:
    """Everything that the tables show.

    warnings say what the evaluation had to leave out; coverage, kept and without_bars how true
    error bars and plausibilities are, and which methods have none; parallel are the methods whose
    ellipsoids are parallel to the axes; provenance is what the numbers were made from and by
    (version, config, digests of the inputs), ready for JSON.
    """

    methods: tuple[Method, ...]
    summaries: tuple[Summary, ...]
    warnings: tuple[str, ...] = ()
    coverage: tuple[Coverage, ...] = ()
    kept: tuple[Kept, ...] = ()
    without_bars: tuple[str, ...] = ()
    parallel: tuple[str, ...] = ()
    provenance: Mapping[str, Any] = field(default_factory=dict)


def sum_up_runs(runs: Sequence[Run]) -> Solving:
    """Sum up how the files of a method were solved; each image weighs the same."""
    images = sum(run.images for run in runs)
    objectives = [run.objective for run in runs if run.objective is not None]
    solved = [run.solved for run in runs if run.solved is not None]
    seconds = [run.seconds for run in runs if run.seconds is not None]
    values = np.concatenate(objectives) if len(objectives) == len(runs) else np.empty(0)
    values = values[np.abs(values) <= LARGEST]
    return Solving(
        mean_objective=float(values.mean()) if len(values) else None,
        milliseconds=1000 * sum(seconds) / images if len(seconds) == len(runs) else None,
        solved=sum(solved) / images if len(solved) == len(runs) else None,
    )


# Tables


COVERAGE = (
    *("method", "group", "landmark", "judged"),
    *(f"inside_{100 * level:.0f}" for level in LEVELS),
    *("median_width", "unit"),
)
KEPT = ("method", "metric", "group", "images", "mean", "kept", "mean_kept", "p_value", "unit")
SUMMARY = ("method", "metric", "group", "sequence", "images", "mean", "median", "p90", "unit")


def write_tables(report: Report) -> dict[str, str]:
    """Return the text of each table by its file; those on error bars where a method has some."""
    found = {
        "report.csv": table_text(SUMMARY, _cells(report.summaries, SUMMARY)),
        "report.json": report_json(report),
    }
    if report.coverage:
        rows = (
            (c.method, c.group, c.landmark, c.judged, *c.inside, width, unit)
            for c in report.coverage
            for unit, width in c.median_width.items()
        )
        found["calibration.csv"] = table_text(COVERAGE, rows)
    if report.kept:
        found["trusted.csv"] = table_text(KEPT, _cells(report.kept, KEPT))
    return found


def _cells(rows: Iterable[object], columns: Sequence[str]) -> Iterable[list[Any]]:
    return ([getattr(row, name) for name in columns] for row in rows)


def table_text(columns: Sequence[str], rows: Iterable[Iterable[Any]]) -> str:
    """Return a header and rows as CSV; None and nan become empty cells."""
    lines: list[str] = []
    # A writer that ends its lines in CR LF puts cells with a CR in quotes, others do not.
    table = csv.writer(SimpleNamespace(write=lambda line: lines.append(f"{line[:-2]}\n")))
    table.writerow(columns)
    table.writerows([value if value == value else None for value in row] for row in rows)
    return "".join(lines)


def report_json(report: Report) -> str:
    """All numbers of the report as JSON; null stands for a number that does not exist."""
    document = {
        "methods": [
            {
                "name": method.name,
                "files": method.files,
                "images": method.images,
                "failed": method.failed,
                "failures": [{"item": i, "reason": r} for i, r in method.failures.items()],
                "solving": method.solving,
            }
            for method in report.methods
        ],
        "summaries": report.summaries,
        "calibration": report.coverage,
        "trusted": report.kept,
        "without_error_bars": report.without_bars,
        "parallel_error_bars": report.parallel,
        "warnings": report.warnings,
        **report.provenance,
    }
    return orjson.dumps(document, option=orjson.OPT_INDENT_2 | orjson.OPT_APPEND_NEWLINE).decode()


# The page


FAILURES_SHOWN = 10
"""Failed items that the page lists per method; the JSON lists more."""

ABSENT = "–"
"""Cell of a number that does not exist."""

HOW_TO_READ_PAIRS = (
    "Each cell is mean / median over the images; of several sequences, the mean of the sequences' "
    "means and of their medians. Normalised errors are shares of the spread of the true shape; "
    "those in boxes, of the diagonal of the box around the landmarks."
)
_HOW_TO_READ = "Each number is the mean, over the sequences of the group, of the sequence's mean."
_HOW_TO_READ_SOLVING = (
    "Means over all images, as reported by the result files. Objectives of different models cannot "
    "be compared: the convex program, the methods with one rotation (convex+refine, alternate), "
    "pmp and mean-shape minimise different functions, and all depend on lambda and the dictionary. "
    "Times are those of the machine and the threads of each fit, for solving alone."
)
_SHARES = [f"{level:.0%}" for level in LEVELS]
_HOW_TO_READ_BARS = (
    f"Share of the landmarks whose truth is inside the {' and '.join(_SHARES)} ellipsoids of the "
    "error bars, the truth placed by scale and translation as in the metric `camera`. Wide bars "
    f"hold anything, so their width stands beside: the median of the {WIDTH_OF:.0%} ellipsoids' "
    "root mean squared semi-axes. Every image has the same weight."
)
_HOW_TO_READ_KEPT = (
    f"Mean error of all images, and of those kept when the {LEAST_TRUSTED:.0%} with the least "
    "p_value of each group are left out. Every image has the same weight, so the first may "
    "differ from the mean over sequences."
)


def as_markdown(blocks: Iterable[str]) -> str:
    """Return blocks as a page of Markdown, in which no name is HTML."""
    return "\n\n".join(re.sub("<(?=[a-zA-Z/!?])", "&lt;", block) for block in blocks) + "\n"


def report_blocks(report: Report, failures: int = FAILURES_SHOWN) -> list[str]:
    """Return the headings, paragraphs, tables and lists of the page, with so many failed items.

    Groups have a table per metric and unit, groups down and methods across. Without groups there is
    one table, methods down, and the means and medians of all metrics across.
    """
    tables = by_kind(summary for summary in report.summaries if summary.sequence is None)
    blocks = ["# Errors against the truth"]
    if {summary.group for summary in report.summaries} == {ALL}:
        blocks += [f"{HOW_TO_READ_PAIRS} Times are those of solving alone."]
        blocks += [_overview(report, tables)]
    else:
        blocks += [_HOW_TO_READ]
        for (metric, unit), summaries in tables.items():
            blocks += [f"## {metric} ({unit})", _errors_table(summaries)]
    blocks += _error_bars(report)
    if report.kept:
        blocks += ["## Least plausible images", _HOW_TO_READ_KEPT, _kept_table(report.kept)]
    counts = [[m.name, str(m.images - m.failed), str(m.failed)] for m in report.methods]
    blocks += ["## Images", markdown_table(["method", "evaluated", "failed"], counts)]
    blocks += _listing("Failed", _failed_items(report, failures))
    blocks += _solving(report)
    return blocks + _listing("Left out", report.warnings)


Entry = TypeVar("Entry", Summary, ImageErrors)


def by_kind(entries: Iterable[Entry]) -> dict[Kind, list[Entry]]:
    """Collect summaries or errors by metric and unit, in order of first appearance."""
    collected: dict[Kind, list[Entry]] = {}
    for entry in entries:
        collected.setdefault((entry.metric, entry.unit), []).append(entry)
    return collected


def markdown_table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a table whose columns line up; those after the first stand to the right."""
    cells = [[on_one_line(cell).replace("|", "\\|") for cell in row] for row in (header, *rows)]
    widths = [max(3, *map(len, column)) for column in zip(*cells, strict=True)]
    rule = ["-" * widths[0], *("-" * (width - 1) + ":" for width in widths[1:])]
    lines = [
        [row[0].ljust(widths[0]), *(c.rjust(w) for c, w in zip(row[1:], widths[1:], strict=True))]
        for row in cells
    ]
    return "\n".join(f"| {' | '.join(line)} |" for line in (lines[0], rule, *lines[1:]))


def on_one_line(text: str) -> str:
    """Return a text without the line breaks that a name may have."""
    return " ".join(text.splitlines())


def number(value: float | None, decimals: int) -> str:
    """Write a number, or that there is none."""
    return ABSENT if value is None or math.isnan(value) else f"{value:.{decimals}f}"


def decimals_of(values: Iterable[float | None]) -> int:
    """Digits after the point: three as in the paper, one from 10 on, more for tiny numbers."""
    known = (value for value in values if value is not None and not math.isnan(value))
    largest = max(known, default=0.0)
    if largest >= 10:
        return 1
    return max(3, 2 - math.floor(math.log10(largest))) if largest > 0 else 3


def _table(rows: Iterable[Mapping[str, str]]) -> str:
    """Return a table of rows by the names of their columns, all of which every row has."""
    rows = list(rows)
    return markdown_table(list(rows[0]), [list(row.values()) for row in rows])


def _place(entry: Coverage | Kept, entries: Sequence[Coverage] | Sequence[Kept]) -> dict[str, str]:
    """Return the method of an entry, and its group where there are groups."""
    grouped = {each.group for each in entries} != {ALL}
    return {"method": entry.method} | ({"group": entry.group} if grouped else {})


def _overview(report: Report, tables: Mapping[Kind, Sequence[Summary]]) -> str:
    """Methods down; mean / median of every metric and unit, then the speed, across."""
    timed = any(method.solving.milliseconds is not None for method in report.methods)
    names = [s.method for summaries in tables.values() for s in summaries]
    names += [method.name for method in report.methods if timed]
    rows = {name: {"method": name} for name in names}
    for (metric, unit), summaries in tables.items():
        decimals = decimals_of(value for s in summaries for value in (s.mean, s.median))
        both = {s.method: [number(v, decimals) for v in (s.mean, s.median)] for s in summaries}
        for name, row in rows.items():
            row[f"{metric} ({unit})"] = " / ".join(both.get(name, [ABSENT]))
    if timed:
        known = {method.name: method.solving for method in report.methods}
        for name, row in rows.items():
            row |= _speed(known.get(name, Solving()))
    return _table(rows.values())


def _errors_table(summaries: Sequence[Summary]) -> str:
    """Groups down, methods across: means."""
    means = {(s.group, s.method): s.mean for s in summaries}
    groups, methods = (dict.fromkeys(names) for names in zip(*means, strict=True))
    decimals = decimals_of(means.values())
    return _table(
        {"": group} | {m: number(means.get((group, m)), decimals) for m in methods}
        for group in groups
    )


def _error_bars(report: Report) -> list[str]:
    """Return how true error bars are: by group, then by landmark; nothing where there are none."""
    coverage, said = report.coverage, [_HOW_TO_READ_BARS]
    if not coverage:
        return []
    if report.without_bars:
        said.append(f"Without error bars, and left out: {listed(report.without_bars, 'and')}.")
    if report.parallel:
        said.append(
            f"The ellipsoids of {listed(report.parallel, 'and')} are parallel to the axes, as the "
            "results hold `shape_sd` without `shape_correlation`."
        )
    whole = [c for c in coverage if c.landmark is None]
    units = dict.fromkeys(unit for c in whole for unit in c.median_width)
    digits = {unit: decimals_of(c.median_width.get(unit) for c in whole) for unit in units}
    by_group = _table(
        {
            **_place(c, whole),
            "landmarks": str(c.judged),
            **dict(zip(_SHARES, map(_share, c.inside), strict=True)),
            **{f"median width ({u})": number(c.median_width.get(u), d) for u, d in digits.items()},
        }
        for c in whole
    )
    single = {(c.method, c.group, c.landmark): c for c in coverage if c.landmark is not None}
    (unit, *_) = next(iter(single.values())).median_width
    decimals = decimals_of(c.median_width[unit] for c in single.values())

    def cell(c: Coverage | None) -> str:
        if c is None or not c.judged:
            return ABSENT
        return " / ".join([*map(_share, c.inside), number(c.median_width[unit], decimals)])

    columns = list(dict.fromkeys((method, group) for method, group, _ in single))
    by_landmark = _table(
        {"": str(name)}
        | {m if g == ALL else f"{m}, {g}": cell(single.get((m, g, name))) for m, g in columns}
        for name in dict.fromkeys(name for *_, name in single)
    )
    title = f"Landmark by landmark, {' / '.join(_SHARES)} / median width ({unit}):"
    return ["## Error bars", " ".join(said), by_group, title, by_landmark]


def _kept_table(kept: Sequence[Kept]) -> str:
    """The first metric and unit of each method."""
    first: dict[str, Kind] = {}
    for k in kept:
        first.setdefault(k.method, (k.metric, k.unit))
    shown = [k for k in kept if first[k.method] == (k.metric, k.unit)]
    decimals = decimals_of(k.mean for k in shown)
    return _table(
        {
            **_place(k, shown),
            "metric": f"{k.metric} ({k.unit})",
            "images": str(k.images),
            "error": number(k.mean, decimals),
            "kept": str(k.kept),
            "error of the kept": number(k.mean_kept, decimals),
            "p_value from": f"{k.p_value:.2g}",
        }
        for k in shown
    )


def _failed_items(report: Report, most: int) -> list[str]:
    lines = []
    for method in report.methods:
        failures = list(method.failures.items())
        lines += [f"{method.name}, {item}: {why}" for item, why in failures[:most]]
        if method.failed > most:
            more = method.failed - most
            listed = f"the first {len(failures):,}" if method.unlisted else "all"
            lines.append(f"{method.name}: {more} more, {listed} listed in report.json")
    return lines


def _solving(report: Report) -> list[str]:
    """The table of what the fits report; empty for results that report nothing, as in CSV."""
    if all(method.solving == Solving() for method in report.methods):
        return []
    decimals = decimals_of(method.solving.mean_objective for method in report.methods)
    table = _table(
        {
            "method": method.name,
            "mean objective": number(method.solving.mean_objective, decimals),
            **_speed(method.solving),
            "optimal or converged": _cut_percent(method.solving.solved),
        }
        for method in report.methods
    )
    return ["## Solving", _HOW_TO_READ_SOLVING, table]


def _speed(solving: Solving) -> dict[str, str]:
    """Cells of the speed; from 100 images per second on whole ones."""
    time, rate = solving.milliseconds, solving.images_per_second
    return {
        "ms per image": ABSENT if time is None else f"{time:.3g}",
        "images/s": ABSENT if rate is None else f"{rate:.0f}" if rate >= 100 else f"{rate:.3g}",
    }


def _cut_percent(share: float | None) -> str:
    """Say 100 % only where it is all of them: digits are cut off, not rounded up."""
    return ABSENT if share is None else f"{math.floor(10_000 * share + 1e-9) / 100:.2f} %"


def _share(share: float) -> str:
    return ABSENT if math.isnan(share) else f"{100 * share:.1f} %"


def _listing(title: str, lines: Sequence[str]) -> list[str]:
    return [f"## {title}", "\n".join(f"- {on_one_line(line)}" for line in lines)] if lines else []
