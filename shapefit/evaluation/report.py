"""The report of an evaluation: all its numbers as CSV, as JSON, as Markdown and in a few lines."""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

import numpy as np
import orjson

from shapefit.arrays import Floats
from shapefit.evaluation.calibration import LEVELS, WIDTH_OF, Coverage
from shapefit.evaluation.metric_table import SHARE
from shapefit.evaluation.summaries import ALL, NORMALISED, Summary
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

    warnings say what the evaluation had to leave out; coverage how true error bars are; factors,
    with which they were true, by method and level; provenance is what the numbers were made from
    and by (version, config, digests of the inputs), ready for JSON.
    """

    methods: tuple[Method, ...]
    summaries: tuple[Summary, ...]
    warnings: tuple[str, ...] = ()
    coverage: tuple[Coverage, ...] = ()
    factors: Mapping[str, Mapping[str, float | None]] = field(default_factory=dict)
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


SUMMARY = ("method", "metric", "group", "sequence", "images", "mean", "median", "p90", "unit")


def report_csv(report: Report) -> str:
    """Return the sums as CSV; those of error bars as the metrics inside_50, inside_90 and width.

    `images` of these are the landmarks judged, and the width is a median.
    """
    rows: list[Iterable[Any]] = [[getattr(s, name) for name in SUMMARY] for s in report.summaries]
    for c in report.coverage:
        for level, share in zip(LEVELS, c.inside, strict=True):
            name = f"inside_{100 * level:.0f}"
            rows.append((c.method, name, c.group, None, c.judged, share, None, None, SHARE))
        for unit, width in c.median_width.items():
            rows.append((c.method, "width", c.group, None, c.judged, None, width, None, unit))
    return table_text(SUMMARY, rows)


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
        "factors": report.factors,
        "warnings": report.warnings,
        **report.provenance,
    }
    return orjson.dumps(document, option=orjson.OPT_INDENT_2 | orjson.OPT_APPEND_NEWLINE).decode()


FAILURES_SHOWN = 10
"""Failed items that the page lists per method; the JSON lists more."""

ABSENT = "–"
"""Cell of a number that does not exist."""

_SHARES = [f"{level:.0%}" for level in LEVELS]
_HOW_TO_READ = (
    "Each cell is mean / median over the images; of several sequences, the mean of the sequences' "
    "means and of their medians. Normalised errors are shares of the spread of the true shape; "
    "those in boxes, of the diagonal of the box around the landmarks."
)
_HOW_TO_READ_BARS = (
    f"Share of the landmarks whose truth is inside the {' and '.join(_SHARES)} ellipsoids of the "
    "error bars, the truth placed in the image by its x and y. Wide bars hold anything, so their "
    f"width stands beside: the median of the {WIDTH_OF:.0%} ellipsoids' root mean squared "
    "semi-axes. Every image has the same weight."
)
_HOW_TO_READ_SOLVING = (
    "As reported by the result files. Objectives of different models, lambdas and dictionaries "
    "cannot be compared. Times are those of the machine and the threads of each fit, for solving "
    "alone."
)


def as_markdown(blocks: Iterable[str]) -> str:
    """Return blocks as a page of Markdown, in which no name is HTML."""
    return "\n\n".join(re.sub("<(?=[a-zA-Z/!?])", "&lt;", block) for block in blocks) + "\n"


def report_blocks(report: Report) -> list[str]:
    """Return the headings, paragraphs, tables and lists of the page."""
    errors = _errors([s for s in report.summaries if s.sequence is None])
    return [
        *("# Errors against the truth", _HOW_TO_READ, errors),
        *_error_bars(report),
        *("## Images", _HOW_TO_READ_SOLVING, _images(report)),
        *_listing("Failed", _failed_items(report)),
        *_listing("Left out", report.warnings),
    ]


def _errors(summaries: Sequence[Summary]) -> str:
    """Groups and methods down; mean / median of every metric and unit across."""
    kinds = dict.fromkeys((s.metric, s.unit) for s in summaries)
    digits = {
        kind: decimals_of(
            value for s in summaries if (s.metric, s.unit) == kind for value in (s.mean, s.median)
        )
        for kind in kinds
    }
    rows: dict[tuple[str, str], dict[str, str]] = {}
    for s in sorted(summaries, key=lambda s: _order(s.group, summaries)):
        row = rows.setdefault((s.group, s.method), {})
        both = [number(value, digits[s.metric, s.unit]) for value in (s.mean, s.median)]
        row[f"{s.metric} ({s.unit})"] = " / ".join(both) if both != [ABSENT] * 2 else ABSENT
    titles = [f"{metric} ({unit})" for metric, unit in kinds]
    return _table(
        {
            **({} if group == ALL else {"group": group}),
            "method": method,
            **{title: row.get(title, ABSENT) for title in titles},
        }
        for (group, method), row in rows.items()
    )


def _order(group: str, summaries: Sequence[Summary]) -> int:
    return next(i for i, s in enumerate(summaries) if s.group == group)


def _error_bars(report: Report) -> list[str]:
    """Return how true error bars and expected errors are; nothing where there are none."""
    coverage = report.coverage
    if not coverage:
        return []
    units = dict.fromkeys(unit for c in coverage for unit in c.median_width)
    digits = {unit: decimals_of(c.median_width.get(unit) for c in coverage) for unit in units}
    ratios = expected_ratios(report.summaries)
    table = _table(
        {
            **({} if c.group == ALL else {"group": c.group}),
            "method": c.method,
            "landmarks": str(c.judged),
            **dict(zip(_SHARES, (f"{100 * share:.1f} %" for share in c.inside), strict=True)),
            **{f"median width ({u})": number(c.median_width.get(u), d) for u, d in digits.items()},
            **({"expected / error": number(ratios.get((c.method, c.group)), 2)} if ratios else {}),
        }
        for c in coverage
    )
    return ["## Error bars", _HOW_TO_READ_BARS, table]


def expected_ratios(summaries: Iterable[Summary]) -> dict[tuple[str, str], float]:
    """Return mean expected over mean measured errors of each method and group that has both."""
    means = {
        (s.metric, s.method, s.group): s.mean
        for s in summaries
        if s.sequence is None and s.unit == NORMALISED
    }
    return {
        (method, group): mean / means["similarity", method, group]
        for (metric, method, group), mean in means.items()
        if metric == "expected" and means.get(("similarity", method, group))
    }


def _images(report: Report) -> str:
    """Methods down; how many images were evaluated, and what the fits report."""
    digits = decimals_of(method.solving.mean_objective for method in report.methods)

    def cells(method: Method) -> dict[str, str]:
        own = method.solving
        time, solved = own.milliseconds, own.solved
        return {
            "method": method.name,
            "evaluated": str(method.images - method.failed),
            "failed": str(method.failed),
            "mean objective": number(own.mean_objective, digits),
            "ms per image": ABSENT if time is None else f"{time:.3g}",
            # 100 % only where it is all of them: digits are cut off, not rounded up.
            "optimal or converged": (
                ABSENT if solved is None else f"{math.floor(10_000 * solved + 1e-9) / 100:.2f} %"
            ),
        }

    return _table(map(cells, report.methods)) if report.methods else ""


def _failed_items(report: Report) -> list[str]:
    lines = []
    for method in report.methods:
        failures = list(method.failures.items())[:FAILURES_SHOWN]
        lines += [f"{method.name}, {item}: {why}" for item, why in failures]
        if method.failed > FAILURES_SHOWN:
            more = method.failed - FAILURES_SHOWN
            listed = f"the first {len(method.failures):,}" if method.unlisted else "all"
            lines.append(f"{method.name}: {more} more, {listed} listed in report.json")
    return lines


def _listing(title: str, lines: Sequence[str]) -> list[str]:
    return [f"## {title}", "\n".join(f"- {on_one_line(line)}" for line in lines)] if lines else []


_SHORT = {"similarity": "error aligned", "camera": "camera frame", "rotation": "rotation"}
"""Metrics of the few lines, and what they are called there."""


def short_lines(report: Report) -> list[str]:
    """Return a few aligned lines for people: the errors of each method and what its bars hold."""
    groups: dict[tuple[str, str], list[Summary]] = {}
    for s in report.summaries:
        if s.sequence is None:
            groups.setdefault((s.method, s.group), []).append(s)
    held = {(c.method, c.group): c.inside[-1] for c in report.coverage}
    ratios, wide = expected_ratios(report.summaries), max(map(len, (m for m, _ in groups)))
    lines = []
    for key, own in groups.items():
        said = [part for name in _SHORT if (part := _in_short(own, name))]
        said.append(f"{max(s.images for s in own)} images")
        said += [f"90% bars hold {100 * held[key]:.0f}%"] if key in held else []
        said += [f"expected / error {ratios[key]:.2f}"] if key in ratios else []
        name, group = key
        lines.append(f"{name.ljust(wide)}  {'' if group == ALL else f'{group}  '}{'; '.join(said)}")
    failed = [m for m in report.methods if m.failed]
    return lines + [f"{m.name.ljust(wide)}  failed: {m.failed} of {m.images}" for m in failed]


def _in_short(summaries: Sequence[Summary], metric: str) -> str:
    """Say mean and median in the unit of the truth, normalised where nobody knows it."""
    own = {s.unit: s for s in summaries if s.metric == metric and not math.isnan(s.mean)}
    if not own:
        return ""
    unit = min(own, key=lambda u: (u == "unknown", u == NORMALISED))
    found, factor = own[unit], 1.0
    if unit == "m" and found.mean < 1:
        unit, factor = "mm", 1000.0
    digits = decimals_of((factor * found.mean, factor * found.median))
    mean, median = (number(factor * value, digits) for value in (found.mean, found.median))
    return f"{_SHORT[metric]} {mean} mean, {median} median ({unit})"


def _table(rows: Iterable[Mapping[str, str]]) -> str:
    """Return a table of rows by the names of their columns, all of which every row has."""
    rows = list(rows)
    return markdown_table(list(rows[0]), [list(row.values()) for row in rows])


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
