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
KEPT = ("method", "metric", "group", "images", "mean", "kept", "mean_kept", "plausibility", "unit")
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
_SPEED = ("ms per image", "images/s")
_SHARES = [f"{level:.0%}" for level in LEVELS]
_HOW_TO_READ_BARS = (
    f"Share of the landmarks whose truth is inside the {' and '.join(_SHARES)} ellipsoids of the "
    "error bars, the truth placed by scale and translation as in the metric `camera`. Wide bars "
    f"hold anything, so their width stands beside: the median of the {WIDTH_OF:.0%} ellipsoids' "
    "root mean squared semi-axes. Every image has the same weight."
)
_HOW_TO_READ_KEPT = (
    f"Mean error of all images, and of those kept when the {LEAST_TRUSTED:.0%} with the least "
    "plausibility of each group are left out. Every image has the same weight, so the first may "
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
    if report.coverage:
        blocks += ["## Error bars", " ".join([_HOW_TO_READ_BARS, *_exceptions(report)])]
        blocks += [_bars_by_group(report.coverage), *_bars_by_landmark(report.coverage)]
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


def _overview(report: Report, tables: Mapping[Kind, Sequence[Summary]]) -> str:
    """Methods down; mean / median of every metric and unit, then the speed, across."""
    cells: dict[str, dict[str, str]] = {}
    for (metric, unit), summaries in tables.items():
        decimals = decimals_of(value for s in summaries for value in (s.mean, s.median))
        for s in summaries:
            both = f"{number(s.mean, decimals)} / {number(s.median, decimals)}"
            cells.setdefault(s.method, {})[f"{metric} ({unit})"] = both
    if any(method.solving.milliseconds is not None for method in report.methods):
        for method in report.methods:
            speed = dict(zip(_SPEED, _speed(method.solving), strict=True))
            cells[method.name] = cells.get(method.name, {}) | speed
    header = list(dict.fromkeys(name for row in cells.values() for name in row))
    header.sort(key=lambda name: name in _SPEED)
    rows = [[name, *(row.get(each, ABSENT) for each in header)] for name, row in cells.items()]
    return markdown_table(["method", *header], rows)


def _errors_table(summaries: Sequence[Summary]) -> str:
    """Groups down, methods across: means."""
    means = {(s.group, s.method): s.mean for s in summaries}
    methods = dict.fromkeys(method for _, method in means)
    decimals = decimals_of(means.values())
    rows = [
        [group, *(number(means.get((group, method)), decimals) for method in methods)]
        for group in dict.fromkeys(group for group, _ in means)
    ]
    return markdown_table(["", *methods], rows)


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


def _bars_by_group(coverage: Sequence[Coverage]) -> str:
    whole = [c for c in coverage if c.landmark is None]
    units = list(dict.fromkeys(unit for c in whole for unit in c.median_width))
    decimals = {unit: decimals_of(c.median_width.get(unit) for c in whole) for unit in units}
    header = ["landmarks", *_SHARES, *(f"median width ({unit})" for unit in units)]
    rows = [
        [
            *(str(c.judged), *map(_share, c.inside)),
            *(number(c.median_width.get(unit), decimals[unit]) for unit in units),
        ]
        for c in whole
    ]
    return _table_of_groups(whole, header, rows)


def _bars_by_landmark(coverage: Sequence[Coverage]) -> list[str]:
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
    title = f"Landmark by landmark, {' / '.join(_SHARES)} / median width ({unit}):"
    return [title, markdown_table(header, rows)]


def _kept_table(kept: Sequence[Kept]) -> str:
    """The first metric and unit of each method."""
    first: dict[str, Kind] = {}
    for k in kept:
        first.setdefault(k.method, (k.metric, k.unit))
    shown = [k for k in kept if first[k.method] == (k.metric, k.unit)]
    decimals = decimals_of(k.mean for k in shown)
    header = ["metric", "images", "error", "kept", "error of the kept", "plausibility from"]
    rows = [
        [
            *(f"{k.metric} ({k.unit})", str(k.images), number(k.mean, decimals)),
            *(str(k.kept), number(k.mean_kept, decimals), f"{k.plausibility:.2g}"),
        ]
        for k in shown
    ]
    return _table_of_groups(shown, header, rows)


def _table_of_groups(
    entries: Sequence[Coverage] | Sequence[Kept], header: list[str], rows: list[list[str]]
) -> str:
    """Put the method before each row, and the group where there are groups."""
    grouped = {entry.group for entry in entries} != {ALL}
    before = [[e.method, e.group] if grouped else [e.method] for e in entries]
    names = ["method", "group"] if grouped else ["method"]
    cells = [[*own, *row] for own, row in zip(before, rows, strict=True)]
    return markdown_table([*names, *header], cells)


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
    told = [(method.name, method.solving) for method in report.methods]
    if all(solving == Solving() for _, solving in told):
        return []
    decimals = decimals_of(s.mean_objective for _, s in told)
    header = ["method", "mean objective", *_SPEED, "optimal or converged"]
    rows = [
        [name, number(s.mean_objective, decimals), *_speed(s), _cut_percent(s.solved)]
        for name, s in told
    ]
    return ["## Solving", _HOW_TO_READ_SOLVING, markdown_table(header, rows)]


def _speed(solving: Solving) -> list[str]:
    """Cells of `_SPEED`; from 100 images per second on whole ones."""
    rate = solving.images_per_second
    return [
        ABSENT if solving.milliseconds is None else f"{solving.milliseconds:.3g}",
        ABSENT if rate is None else f"{rate:.0f}" if rate >= 100 else f"{rate:.3g}",
    ]


def _cut_percent(share: float | None) -> str:
    """Say 100 % only where it is all of them: digits are cut off, not rounded up."""
    return ABSENT if share is None else f"{math.floor(10_000 * share + 1e-9) / 100:.2f} %"


def _share(share: float) -> str:
    return ABSENT if math.isnan(share) else f"{100 * share:.1f} %"


def _listing(title: str, lines: Sequence[str]) -> list[str]:
    return [f"## {title}", "\n".join(f"- {on_one_line(line)}" for line in lines)] if lines else []
