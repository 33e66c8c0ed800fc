"""Errors summed up over sequences and groups: as CSV, as JSON, as Markdown and in a few
lines.
"""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from io import StringIO
from typing import Any

import numpy as np

from shapefit.arrays import Floats
from shapefit.errors import abbreviate, input_error, printable
from shapefit.evaluation.calibration import QUANTILES
from shapefit.evaluation.metrics import SHARE

ALL = "all"
"""Name of the one group, and of the one sequence, where none are named."""
NORMALISED, UNKNOWN_UNIT = "normalised", "unknown"
"""Units of errors against the truth scaled to unit standard deviation, and of a file
without.
"""
BARS = [f"in {level:.0%} bars" for level in QUANTILES]
BARS_50 = (BARS[0], "%")
BARS_90 = (BARS[-1], "%")
RATIO = ("expected / error", "")
"""Columns of error bars, and of mean expected over mean measured errors."""
MOST_SHOWN = 10
"""Failed images of a method that the page lists; report.json has all."""
ABSENT = "–"
"""Cell of a number that does not exist."""
SUMMARY = (
    "method",
    "metric",
    "group",
    "sequence",
    "images",
    "mean",
    "median",
    "p90",
    "unit",
)
"""Columns of report.csv."""

_ERRORS = (
    "Each cell is mean / median over the images; of several sequences, the mean over "
    "them. Normalised errors are shares of the standard deviation of the true shape; "
    "those in boxes, of the diagonal of the box around the landmarks."
)
_BARS = (
    "Bars: the share of landmarks whose truth, placed in the image by its x and y, is "
    "in the ellipsoids. Wide bars hold anything: the width is the median of the 90% "
    "ellipsoids' root mean squared semi-axes."
)
_SHORT = {
    "similarity": "error aligned",
    "camera": "camera frame",
    "rotation": "rotation",
}
"""Metrics of the few lines, and their names there."""

Kind = tuple[str, str]
"""A metric and its unit."""
Row = tuple[str, str]
"""A group and a method."""
Document = Mapping[str, Any]
"""What report.json holds: methods, summaries, calibration, factors, warnings, and what
made it.
"""


@dataclass(frozen=True)
class Summary:
    """Errors of one method in one metric and unit over a sequence, or over a group.

    `sequence` is None for a group. `images` counts the images with an error, `failed`
    those without. For a sequence mean, median and 90th percentile are over its images;
    for a group they are the means of these over its sequences. nan where no image has
    an error.
    """

    method: str
    metric: str
    unit: str
    group: str
    sequence: str | None
    images: int
    failed: int
    mean: float
    median: float
    p90: float


def group_sequences(
    groups: Mapping[str, str], sequences: Iterable[str]
) -> dict[str, tuple[str, ...]]:
    """Sequences of each group (name -> glob).

    Without groups all are in the group `all`; a sequence may be in several groups.
    Raises InputError where no sequence is in any group.
    """
    names = tuple(dict.fromkeys(filter(None, sequences)))
    if not groups:
        return {ALL: names}
    grouping = {
        group: tuple(name for name in names if fnmatchcase(name, glob))
        for group, glob in groups.items()
    }
    if not any(grouping.values()):
        fault = f"no sequence matches any group; the sequences are {abbreviate(names)}"
        raise input_error("groups", fault, "correct the globs, or leave `groups` out")
    return grouping


def summarise(
    method: str,
    sequences: Sequence[str],
    errors: Mapping[Kind, Floats],
    grouping: Mapping[str, Sequence[str]],
) -> Iterator[Summary]:
    """Sum up errors (n,) by metric and unit: each group followed by its sequences (n,).

    nan is a failed image; an infinite error does not count. A sequence or group without
    an image that counts is omitted.
    """
    names, codes = np.unique(np.array(sequences, dtype=str), return_inverse=True)
    order = np.argsort(codes, kind="stable")
    starts = np.searchsorted(codes[order], np.arange(1, len(names)))
    for (metric, unit), values in errors.items():
        parts = np.split(values[order], starts)
        rows = {
            name: _statistics(part)
            for name, part in zip(names.tolist(), parts, strict=True)
        }
        for group, members in grouping.items():
            inside = {
                name: rows[name]
                for name in members
                if name in rows and any(rows[name][:2])
            }
            if not inside:
                continue
            table = np.array(list(inside.values()))
            fitted = table[table[:, 0] > 0, 2:]
            mean = fitted.mean(axis=0) if len(fitted) else np.full(3, np.nan)
            whole = (*table[:, :2].sum(axis=0), *mean)
            for name, (count, failed, *numbers) in ((None, whole), *inside.items()):
                counts = int(count), int(failed)
                yield Summary(
                    method, metric, unit, group, name, *counts, *map(float, numbers)
                )


def _statistics(values: Floats) -> tuple[float, ...]:
    """Return how many errors are finite and nan, and mean, median and 90th percentile
    of them.
    """
    finite = np.sort(values[np.isfinite(values)])
    numbers = (np.nan,) * 3
    if n := len(finite):
        places = np.array([0.5, 0.9]) * (n - 1)
        numbers = (finite.mean(), *np.interp(places, np.arange(n), finite))
    return n, int(np.isnan(values).sum()), *numbers


def report_csv(report: Document) -> str:
    """Return the sums as CSV; those of error bars as the metrics inside_50, inside_90
    and width.

    `images` of these are the landmarks counted, and the width is a median.
    """
    rows: list[Iterable[Any]] = [
        [getattr(s, name) for name in SUMMARY] for s in report["summaries"]
    ]
    for c in report["calibration"]:
        method, group, counted = c["method"], c["group"], c["counted"]
        for level, share in zip(QUANTILES, c["inside"], strict=True):
            name = f"inside_{100 * level:.0f}"
            rows.append((method, name, group, None, counted, share, None, None, SHARE))
        for unit, width in c["median_width"].items():
            rows.append(
                (method, "width", group, None, counted, None, width, None, unit)
            )
    text = StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(SUMMARY)
    table.writerows(
        [value if value == value else None for value in row] for row in rows
    )
    return text.getvalue()


def report_markdown(report: Document, plot: str = "") -> str:
    """Return the page: a table of errors and error bars, failures, and the plot's
    file.
    """
    counts, columns = table_of(report)
    digits = {
        kind: decimals_of(v for row in c.values() for v in row)
        for kind, c in columns.items()
    }
    groups, rows = [*dict.fromkeys(group for group, _ in counts)], []
    for row in sorted(counts, key=lambda row: groups.index(row[0])):
        cells = [*row, *map(str, counts[row])]
        for kind, column in columns.items():
            cells.append(
                " / ".join(number(v, digits[kind]) for v in column.get(row, (None,)))
            )
        rows.append(cells)
    names = [f"{name} ({unit})" if unit else name for name, unit in columns]
    header, alone = ["group", "method", "images", "failed", *names], groups == [ALL]
    table = markdown_table(header[alone:], [row[alone:] for row in rows])
    blocks = [
        "# Errors against the truth",
        _ERRORS,
        *[_BARS] * bool(report["calibration"]),
        table,
    ]
    failed: list[str] = []
    for method in report["methods"]:
        name, failures = method["name"], method["failures"]
        failed += [
            f"{name}, {one['item']}: {one['reason']}" for one in failures[:MOST_SHOWN]
        ]
    for title, lines in (("Failed", failed), ("Warnings", report["warnings"])):
        if lines:
            blocks += [
                f"## {title}",
                "\n".join(f"- {' '.join(line.split())}" for line in lines),
            ]
    if plot:
        blocks += ["## Plot", f"![errors, sorted]({plot})"]
    # No name is HTML, or moves the cursor of a terminal.
    text = re.sub("<(?=[a-zA-Z/!?])", "&lt;", "\n\n".join(blocks))
    return "\n".join(map(printable, text.split("\n"))) + "\n"


def table_of(
    report: Document,
) -> tuple[dict[Row, tuple[int, int]], dict[Kind, dict[Row, tuple[float, ...]]]]:
    """Return images and failed images by group and method; and the numbers of each
    quantity.

    Those of a metric are mean and median; then come the error bars, and expected /
    error.
    """
    counts: dict[Row, tuple[int, int]] = {}
    columns: dict[Kind, dict[Row, tuple[float, ...]]] = {}
    for s in report["summaries"]:
        if s.sequence is None:
            counts.setdefault((s.group, s.method), (s.images, s.failed))
            column = columns.setdefault((s.metric, s.unit), {})
            if not math.isnan(s.mean):
                column[s.group, s.method] = s.mean, s.median
    for c in report["calibration"]:
        bars = {
            (name, "%"): 100 * share
            for name, share in zip(BARS, c["inside"], strict=True)
        }
        bars |= {("width", unit): width for unit, width in c["median_width"].items()}
        for kind, value in bars.items():
            columns.setdefault(kind, {})[c["group"], c["method"]] = (value,)
    measured = columns.get(("similarity", NORMALISED), {})
    for row, (mean, _) in columns.get(("expected", NORMALISED), {}).items():
        if measured.get(row, (0.0,))[0]:
            columns.setdefault(RATIO, {})[row] = (mean / measured[row][0],)
    return counts, columns


def short_lines(report: Document) -> list[str]:
    """Return a few aligned lines for people: the errors of each method and what its
    bars hold.
    """
    counts, columns = table_of(report)
    wide, lines = max(len(method) for _, method in counts), []
    for row in counts:
        errors: dict[str, str] = {}
        for (metric, unit), column in columns.items():
            # The last unit is that of the truth.
            if metric in _SHORT and unit != UNKNOWN_UNIT and row in column:
                factor, unit = (
                    (1000, "mm") if unit == "m" and column[row][0] < 1 else (1, unit)
                )
                both = [factor * value for value in column[row]]
                mean, median = (number(value, decimals_of(both)) for value in both)
                errors[metric] = (
                    f"{_SHORT[metric]} {mean} mean, {median} median ({unit})"
                )
        texts = [*errors.values(), f"{counts[row][0]} images"]
        for kind, text in (
            (BARS_50, "50% bars hold {:.0f}%"),
            (BARS_90, "90% bars hold {:.0f}%"),
            (RATIO, "expected / error {:.2f}"),
        ):
            if row in columns.get(kind, {}):
                texts.append(text.format(*columns[kind][row]))
        group, method = row
        lines.append(
            "  ".join([method.ljust(wide), *[group] * (group != ALL), "; ".join(texts)])
        )
    for method in report["methods"]:
        if method["failed"]:
            text = f"failed: {method['failed']} of {method['images']}"
            lines.append(f"{method['name'].ljust(wide)}  {text}")
    return lines


def markdown_table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a table whose columns line up; those after the first stand to the
    right.
    """
    cells = [
        [" ".join(cell.split()).replace("|", "\\|") for cell in row]
        for row in (header, *rows)
    ]
    widths = [max(3, *map(len, column)) for column in zip(*cells, strict=True)]
    rule = ["-" * widths[0], *("-" * (width - 1) + ":" for width in widths[1:])]
    lines = [
        [
            row[0].ljust(widths[0]),
            *(c.rjust(w) for c, w in zip(row[1:], widths[1:], strict=True)),
        ]
        for row in cells
    ]
    return "\n".join(f"| {' | '.join(line)} |" for line in (lines[0], rule, *lines[1:]))


def number(value: float | None, decimals: int) -> str:
    """Write a number, or that there is none."""
    return ABSENT if value is None or math.isnan(value) else f"{value:.{decimals}f}"


def decimals_of(values: Iterable[float | None]) -> int:
    """Digits after the point: three as in the paper, one from 10 on, more for tiny
    numbers.
    """
    finite = (value for value in values if value is not None and not math.isnan(value))
    largest = max(finite, default=0.0)
    if largest >= 10:
        return 1
    return max(3, 2 - math.floor(math.log10(largest))) if largest > 0 else 3
