"""The report of an evaluation: all its numbers as CSV, as JSON, as Markdown and in a few lines."""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from io import StringIO
from itertools import compress
from typing import Any

import numpy as np
import orjson

from shapefit.arrays import Floats
from shapefit.evaluation.calibration import QUANTILES, WIDTH_OF, Coverage
from shapefit.evaluation.metrics import SHARE
from shapefit.evaluation.summaries import ALL, NORMALISED, Kind, Summary

MOST_SHOWN = 10
"""Failed images of a method that the page lists."""
ABSENT = "–"
"""Cell of a number that does not exist."""
PER_IMAGE = ("method", "sequence", "item", "metric", "error", "unit")
"""Columns of per_image.csv."""
SUMMARY = ("method", "metric", "group", "sequence", "images", "mean", "median", "p90", "unit")
"""Columns of report.csv."""

_SHARES = [f"{level:.0%}" for level in QUANTILES]
_ERRORS = (
    "Each cell is mean / median over the images; of several sequences, the mean of the sequences' "
    "means and of their medians. Normalised errors are shares of the standard deviation of the "
    "true shape; those in boxes, of the diagonal of the box around the landmarks."
)
_BARS = (
    f"Share of the landmarks whose truth is inside the {' and '.join(_SHARES)} ellipsoids of the "
    "error bars, after the truth was placed in the image by its x and y. Wide bars hold anything, "
    f"so their width is given too: the median of the {WIDTH_OF:.0%} ellipsoids' root mean squared "
    "semi-axes. Every image has the same weight."
)


@dataclass(frozen=True)
class Method:
    """One method: where its results are, how many images, how many failed, and why.

    `failures` maps the failed items to the reason; the mean objective is that of the images that
    have one, None where not all files state it.
    """

    name: str
    files: tuple[str, ...]
    images: int
    failures: Mapping[str, str] = field(default_factory=dict)
    mean_objective: float | None = None


@dataclass(frozen=True)
class Report:
    """Everything that the tables show.

    warnings say what was ignored; coverage how true error bars are; factors, with which they would
    be true, by method and level; provenance (version, config, digests of the inputs) is ready for
    JSON.
    """

    methods: tuple[Method, ...]
    summaries: tuple[Summary, ...]
    warnings: tuple[str, ...] = ()
    coverage: tuple[Coverage, ...] = ()
    factors: Mapping[str, Mapping[str, float | None]] = field(default_factory=dict)
    provenance: Mapping[str, Any] = field(default_factory=dict)


def per_image_rows(
    method: str, sequences: Sequence[str], items: Sequence[str], errors: Mapping[Kind, Floats]
) -> Iterator[bytes]:
    """Yield lines of per_image.csv: errors (n,) by metric and unit; that of a failed one is empty.

    An infinite error does not count and has no line.
    """
    special = re.compile('[,"\r\n]').search

    def cell(text: str) -> str:
        return '"{}"'.format(text.replace('"', '""')) if special(text) else text

    names = [f"{cell(a)},{cell(b)}" for a, b in zip(sequences, items, strict=True)]
    for (metric, unit), values in errors.items():
        before, between, after = f"{cell(method)},", f",{cell(metric)},", f",{cell(unit)}\n"
        counts = ~np.isinf(values)
        texts = ["" if value != value else repr(value) for value in values[counts].tolist()]
        pairs = zip(compress(names, counts.tolist()), texts, strict=True)
        # Joined, not formatted, which takes twice as long.
        if lines := f"{after}{before}".join(map(between.join, pairs)):
            yield f"{before}{lines}{after}".encode("utf-8", "surrogateescape")


def report_csv(report: Report) -> str:
    """Return the sums as CSV; those of error bars as the metrics inside_50, inside_90 and width.

    `images` of these are the landmarks judged, and the width is a median.
    """
    rows: list[Iterable[Any]] = [[getattr(s, name) for name in SUMMARY] for s in report.summaries]
    for c in report.coverage:
        for level, share in zip(QUANTILES, c.inside, strict=True):
            name = f"inside_{100 * level:.0f}"
            rows.append((c.method, name, c.group, None, c.counted, share, None, None, SHARE))
        for unit, width in c.median_width.items():
            rows.append((c.method, "width", c.group, None, c.counted, None, width, None, unit))
    text = StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(SUMMARY)
    table.writerows([value if value == value else None for value in row] for row in rows)
    return text.getvalue()


def report_json(report: Report) -> str:
    """All numbers of the report as JSON; null stands for a number that does not exist."""

    def method_json(method: Method) -> dict[str, Any]:
        failures = [{"item": item, "reason": why} for item, why in method.failures.items()]
        return {**vars(method), "failed": len(failures), "failures": failures}

    document = {
        "methods": [method_json(method) for method in report.methods],
        "summaries": report.summaries,
        "calibration": report.coverage,
        "factors": report.factors,
        "warnings": report.warnings,
        **report.provenance,
    }
    return orjson.dumps(document, option=orjson.OPT_INDENT_2 | orjson.OPT_APPEND_NEWLINE).decode()


def report_markdown(report: Report, plot: str = "") -> str:
    """Return the page: tables of errors, error bars and images, failures, and the plot's file."""
    blocks = ["# Errors against the truth", _ERRORS, _error_table(report)]
    if report.coverage:
        blocks += ["## Error bars", _BARS, _error_bars(report)]
    for title, lines in (("Failed", _failed(report.methods)), ("Warnings", report.warnings)):
        if lines:
            blocks += [f"## {title}", "\n".join(f"- {_on_one_line(line)}" for line in lines)]
    if plot:
        blocks += ["## Plot", f"![errors, sorted]({plot})"]
    # No name is HTML.
    return "\n\n".join(re.sub("<(?=[a-zA-Z/!?])", "&lt;", block) for block in blocks) + "\n"


def _error_table(report: Report) -> str:
    """Groups and methods down; mean / median of every metric and unit across, and images."""
    summaries = [s for s in report.summaries if s.sequence is None]
    groups = [*dict.fromkeys(s.group for s in summaries)]
    columns: dict[Kind, list[float]] = {}
    for s in summaries:
        columns.setdefault((s.metric, s.unit), []).extend((s.mean, s.median))
    digits = {kind: decimals_of(values) for kind, values in columns.items()}
    rows: dict[tuple[str, str], dict[str, str]] = {}
    for s in sorted(summaries, key=lambda s: groups.index(s.group)):
        row = rows.setdefault((s.group, s.method), {} if s.group == ALL else {"group": s.group})
        if "method" not in row:
            row |= {"method": s.method, "images": str(s.images), "failed": str(s.failed)}
            row |= {f"{metric} ({unit})": ABSENT for metric, unit in columns}
        if not math.isnan(s.mean):
            both = (number(value, digits[s.metric, s.unit]) for value in (s.mean, s.median))
            row[f"{s.metric} ({s.unit})"] = " / ".join(both)
    return _table(rows.values())


def _error_bars(report: Report) -> str:
    """Groups and methods down; shares inside, widths, and how true expected errors are."""
    coverage, ratios = report.coverage, expected_ratios(report.summaries)
    units = dict.fromkeys(unit for c in coverage for unit in c.median_width)
    digits = {unit: decimals_of(c.median_width.get(unit) for c in coverage) for unit in units}
    return _table(
        {
            **({} if c.group == ALL else {"group": c.group}),
            "method": c.method,
            "landmarks": str(c.counted),
            **dict(zip(_SHARES, (f"{100 * share:.1f} %" for share in c.inside), strict=True)),
            **{f"median width ({u})": number(c.median_width.get(u), d) for u, d in digits.items()},
            **({"expected / error": number(ratios.get((c.method, c.group)), 2)} if ratios else {}),
        }
        for c in coverage
    )


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


def _failed(methods: Iterable[Method]) -> list[str]:
    lines = []
    for method in methods:
        failures = [f"{method.name}, {item}: {why}" for item, why in method.failures.items()]
        lines += failures[:MOST_SHOWN]
        if more := len(failures) - MOST_SHOWN if len(failures) > MOST_SHOWN else 0:
            lines.append(f"{method.name}: {more} more, all listed in report.json")
    return lines


_SHORT = {"similarity": "error aligned", "camera": "camera frame", "rotation": "rotation"}
"""Metrics of the few lines, and what they are called there."""


def short_lines(report: Report) -> list[str]:
    """Return a few aligned lines for people: the errors of each method and what its bars hold."""
    groups: dict[tuple[str, str], list[Summary]] = {}
    for s in report.summaries:
        if s.sequence is None:
            groups.setdefault((s.method, s.group), []).append(s)
    inside = {(c.method, c.group): c.inside[-1] for c in report.coverage}
    ratios, wide = expected_ratios(report.summaries), max(len(method) for method, _ in groups)
    lines = []
    for (method, group), rows in groups.items():
        parts = [part for name in _SHORT if (part := _in_short(rows, name))]
        parts.append(f"{max(s.images for s in rows)} images")
        if (share := inside.get((method, group))) is not None:
            parts.append(f"90% bars hold {100 * share:.0f}%")
        if (ratio := ratios.get((method, group))) is not None:
            parts.append(f"expected / error {ratio:.2f}")
        where = "" if group == ALL else f"{group}  "
        lines.append(f"{method.ljust(wide)}  {where}{'; '.join(parts)}")
    return lines + [
        f"{m.name.ljust(wide)}  failed: {len(m.failures)} of {m.images}"
        for m in report.methods
        if m.failures
    ]


def _in_short(summaries: Sequence[Summary], metric: str) -> str:
    """Say mean and median in the unit of the truth, normalised where that is unknown."""
    by_unit = {s.unit: s for s in summaries if s.metric == metric and not math.isnan(s.mean)}
    if not by_unit:
        return ""
    unit = min(by_unit, key=lambda u: (u == "unknown", u == NORMALISED))
    values = [by_unit[unit].mean, by_unit[unit].median]
    if unit == "m" and values[0] < 1:
        unit, values = "mm", [1000 * value for value in values]
    mean, median = (number(value, decimals_of(values)) for value in values)
    return f"{_SHORT[metric]} {mean} mean, {median} median ({unit})"


def _table(rows: Iterable[Mapping[str, str]]) -> str:
    """Return a table of rows by the names of their columns, all of which every row has."""
    rows = list(rows)
    return markdown_table(list(rows[0]), [list(row.values()) for row in rows]) if rows else ""


def markdown_table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a table whose columns line up; those after the first stand to the right."""
    cells = [[_on_one_line(cell).replace("|", "\\|") for cell in row] for row in (header, *rows)]
    widths = [max(3, *map(len, column)) for column in zip(*cells, strict=True)]
    rule = ["-" * widths[0], *("-" * (width - 1) + ":" for width in widths[1:])]
    lines = [
        [row[0].ljust(widths[0]), *(c.rjust(w) for c, w in zip(row[1:], widths[1:], strict=True))]
        for row in cells
    ]
    return "\n".join(f"| {' | '.join(line)} |" for line in (lines[0], rule, *lines[1:]))


def _on_one_line(text: str) -> str:
    """Return a text without the line breaks that a name may have."""
    return " ".join(text.splitlines())


def number(value: float | None, decimals: int) -> str:
    """Write a number, or that there is none."""
    return ABSENT if value is None or math.isnan(value) else f"{value:.{decimals}f}"


def decimals_of(values: Iterable[float | None]) -> int:
    """Digits after the point: three as in the paper, one from 10 on, more for tiny numbers."""
    finite = (value for value in values if value is not None and not math.isnan(value))
    largest = max(finite, default=0.0)
    if largest >= 10:
        return 1
    return max(3, 2 - math.floor(math.log10(largest))) if largest > 0 else 3
