"""Errors summed up over sequences, groups, landmarks: as CSV, and in a few lines."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from io import StringIO
from typing import NamedTuple, TypedDict

import numpy as np

from shapefit.arrays import Floats
from shapefit.errors import abbreviate, counted, input_error
from shapefit.evaluation.calibration import SQUARED_RADII, Coverage
from shapefit.evaluation.metrics import SHARE
from shapefit.evaluation.units import ShownUnit, shown_unit

ALL = "all"
"""Name of the one group, and of the one sequence, where none are named."""

NORMALISED = "normalised"
"""Unit of errors against the truth scaled to unit standard deviation."""

UNSTATED_UNIT = "unknown"
"""Unit of a file that states none."""

BARS = [f"in {share:.0%} bars" for share in SQUARED_RADII]
"""Columns of error bars."""

BARS_50 = (BARS[0], "%")
BARS_90 = (BARS[-1], "%")

RATIO = ("expected / error", "")
"""Column of mean expected over mean measured errors."""

ABSENT = "–"
"""Cell of a number that does not exist."""

ALIGNED = "similarity"
"""Metric of which landmarks, sequences and examples are shown."""

CSV_COLUMNS = (
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
"""Of report.csv."""

PART_CSV_COLUMNS = ("images", "mean", "median", "p90", "unit")
"""Of per_landmark.csv and per_angle.csv, after the method and the part."""

SHORT_NAMES = {
    "similarity": "error aligned",
    "camera": "camera frame",
    "rotation": "rotation",
}
"""Metrics of the few lines and of the page, and their names there."""

Quantity = tuple[str, str]
"""A metric, or a column of error bars, and its unit."""

GroupMethod = tuple[str, str]
"""A group and a method: a row of the page's table."""

QuantityColumn = dict[GroupMethod, tuple[float, ...]]
"""The numbers of one quantity by row."""


@dataclass(frozen=True)
class ErrorSummary:
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


@dataclass(frozen=True)
class PartSummary:
    """Errors of one landmark or joint angle by one method, over all images.

    `images` counts the images in which it was measured.
    """

    method: str
    part: str
    unit: str
    images: int
    mean: float
    median: float
    p90: float


class FailedImage(TypedDict):
    """An image without an error, and why."""

    item: str
    reason: str


class MethodOutcome(TypedDict):
    """What became of the images of a method.

    name is the user's; method is that of `fit`, None where the file has none.
    """

    name: str
    method: str | None
    files: list[str]
    images: int
    failures: list[FailedImage]
    mean_objective: float | None
    failed: int


class Document(TypedDict):
    """What report.json holds; factors are those of `bar_scale_factors` by method."""

    methods: list[MethodOutcome]
    summaries: list[ErrorSummary]
    landmarks: list[PartSummary]
    angles: list[PartSummary]
    calibration: list[Coverage]
    factors: dict[str, dict[str, float | None]]
    warnings: list[str]
    version: str
    config: dict[str, object]
    inputs: dict[str, str]


def group_sequences(
    groups: Mapping[str, str], sequences: Iterable[str]
) -> dict[str, tuple[str, ...]]:
    """Return the sequences of each group, by its name.

    groups: name -> glob of sequences. Without groups all are in the group `all`; a
    sequence may be in several groups. Raises InputError where no sequence is in any
    group.
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


def summarise_errors(
    method: str,
    sequences: Sequence[str],
    errors: Mapping[Quantity, Floats],
    grouping: Mapping[str, Sequence[str]],
) -> Iterator[ErrorSummary]:
    """Yield a summary of errors for each metric, group and sequence, a group first.

    sequences (n,): that of each image; errors (n,) by metric and unit, of which nan is
    a failed image; an infinite error does not count. A sequence or group without an
    image that counts is omitted.
    """
    names, codes = np.unique(np.array(sequences, dtype=str), return_inverse=True)
    order = np.argsort(codes, kind="stable")
    starts = np.searchsorted(codes[order], np.arange(1, len(names)))
    for (metric, unit), values in errors.items():
        parts = np.split(values[order], starts)
        of_sequence = {
            name: _statistics(part)
            for name, part in zip(names.tolist(), parts, strict=True)
        }
        for group, members in grouping.items():
            inside = {
                name: of_sequence[name]
                for name in members
                if name in of_sequence and of_sequence[name].has_images
            }
            if not inside:
                continue
            of_group = _mean_over_sequences(list(inside.values()))
            for sequence, numbers in ((None, of_group), *inside.items()):
                yield ErrorSummary(method, metric, unit, group, sequence, *numbers)


def summarise_parts(
    method: str, parts: Sequence[str], errors: Mapping[str, Floats]
) -> Iterator[PartSummary]:
    """Yield a summary of each landmark or angle, of errors (n, parts) by unit.

    A part that no image has is left out.
    """
    for unit, values in errors.items():
        for part, column in zip(parts, values.T, strict=True):
            images, _, *numbers = _statistics(column)
            if images:
                yield PartSummary(method, part, unit, images, *numbers)


class _Statistics(NamedTuple):
    """How many errors are finite and nan, and three numbers of the finite ones."""

    images: int
    failed: int
    mean: float
    median: float
    p90: float

    @property
    def has_images(self) -> bool:
        """Whether any image was measured or failed."""
        return self.images > 0 or self.failed > 0


def _statistics(values: Floats) -> _Statistics:
    """Return the statistics of errors (n,): nan has failed, inf does not count."""
    finite = values[np.isfinite(values)]
    n = len(finite)
    failed = int(np.isnan(values).sum())
    if n == 0:
        return _Statistics(0, failed, np.nan, np.nan, np.nan)
    median, p90 = np.percentile(finite, [50, 90]).tolist()
    return _Statistics(n, failed, float(finite.mean()), median, p90)


def _mean_over_sequences(sequences: Sequence[_Statistics]) -> _Statistics:
    """Return the statistics of a group: images summed, numbers averaged over sequences.

    Sequences without a measured image have no part in the averages.
    """
    table = np.array(sequences)
    images, failed = table[:, :2].sum(axis=0)
    with_images = table[table[:, 0] > 0, 2:]
    mean = np.full(3, np.nan)
    if len(with_images):
        mean = with_images.mean(axis=0)
    return _Statistics(int(images), int(failed), *mean.tolist())


def report_csv(report: Document) -> str:
    """Return the text of report.csv: summaries of errors, then of error bars.

    The metrics of error bars are inside_50, inside_90 and width. `images` of these are
    the landmarks counted, and the width is a median.
    """
    rows = [
        [getattr(summary, name) for name in CSV_COLUMNS]
        for summary in report["summaries"]
    ]
    for coverage in report["calibration"]:
        rows += _rows_of_coverage(coverage)
    text = StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(CSV_COLUMNS)
    table.writerows(
        [None if _is_nan(value) else value for value in row] for row in rows
    )
    return text.getvalue()


def _rows_of_coverage(coverage: Coverage) -> list[list[str | float | None]]:
    """Return the rows of report.csv on the error bars of a method in a group."""
    method = coverage["method"]
    group = coverage["group"]
    counted = coverage["counted"]
    rows: list[list[str | float | None]] = []
    for nominal, share in zip(SQUARED_RADII, coverage["inside"], strict=True):
        name = f"inside_{100 * nominal:.0f}"
        rows.append([method, name, group, None, counted, share, None, None, SHARE])
    for unit, width in coverage["median_width"].items():
        rows.append([method, "width", group, None, counted, None, width, None, unit])
    return rows


def _is_nan(value: str | float | None) -> bool:
    return isinstance(value, float) and math.isnan(value)


def parts_csv(parts: Sequence[PartSummary], noun: str) -> str:
    """Return the text of per_landmark.csv or per_angle.csv; noun heads the column."""
    text = StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(("method", noun, *PART_CSV_COLUMNS))
    table.writerows(
        [one.method, one.part, *(getattr(one, name) for name in PART_CSV_COLUMNS)]
        for one in parts
    )
    return text.getvalue()


def shown_units(report: Document) -> dict[str, ShownUnit]:
    """Return for each unit of the report the unit in which people read its numbers."""
    means: dict[str, list[float]] = {}
    for summary in report["summaries"]:
        means.setdefault(summary.unit, []).append(summary.mean)
    for coverage in report["calibration"]:
        for unit, width in coverage["median_width"].items():
            means.setdefault(unit, []).append(width)
    return {unit: shown_unit(unit, of_unit) for unit, of_unit in means.items()}


def table_of(
    report: Document,
) -> tuple[dict[GroupMethod, tuple[int, int]], dict[Quantity, QuantityColumn]]:
    """Return counts of images, and columns of errors, both by group and method.

    The counts are measured and failed images; the columns are numbers by quantity, in
    the units that people read. Those of a metric are mean and median; then come the
    error bars, and expected / error.
    """
    shown = shown_units(report)
    counts: dict[GroupMethod, tuple[int, int]] = {}
    columns: dict[Quantity, QuantityColumn] = {}
    for summary in report["summaries"]:
        if summary.sequence is not None:
            continue
        row = (summary.group, summary.method)
        counts.setdefault(row, (summary.images, summary.failed))
        unit, factor = shown[summary.unit]
        column = columns.setdefault((summary.metric, unit), {})
        if not math.isnan(summary.mean):
            column[row] = (factor * summary.mean, factor * summary.median)
    for coverage in report["calibration"]:
        row = (coverage["group"], coverage["method"])
        for name, share in zip(BARS, coverage["inside"], strict=True):
            columns.setdefault((name, "%"), {})[row] = (100 * share,)
        for unit_of_file, width in coverage["median_width"].items():
            unit, factor = shown[unit_of_file]
            columns.setdefault(("width", unit), {})[row] = (factor * width,)
    measured = columns.get(("similarity", NORMALISED), {})
    for row, (expected, _) in columns.get(("expected", NORMALISED), {}).items():
        error, *_ = measured.get(row, (0.0,))
        if error:
            columns.setdefault(RATIO, {})[row] = (expected / error,)
    return counts, columns


def short_lines(report: Document) -> list[str]:
    """Return a few aligned lines for people: errors of methods, what bars hold."""
    counts, columns = table_of(report)
    width = max(len(method) for _, method in counts)
    lines = []
    for row, (images, _) in counts.items():
        texts = [*_short_errors(columns, row), _describe_images(report, row, images)]
        texts += _short_bars(columns, row)
        group, method = row
        cells = [method.ljust(width), "; ".join(texts)]
        if group != ALL:
            cells.insert(1, group)
        lines.append("  ".join(cells))
    for outcome in report["methods"]:
        angles = [one for one in report["angles"] if one.method == outcome["name"]]
        if angles:
            worst = max(angles, key=lambda one: one.mean)
            mean = sum(one.mean for one in angles) / len(angles)
            text = f"joint angles {mean:.1f} mean (deg); {worst.part} {worst.mean:.1f}"
            lines.append(f"{outcome['name'].ljust(width)}  {text}")
        if outcome["failed"]:
            text = f"failed: {outcome['failed']} of {outcome['images']}"
            lines.append(f"{outcome['name'].ljust(width)}  {text}")
    return lines


def _short_errors(
    columns: Mapping[Quantity, QuantityColumn], row: GroupMethod
) -> Iterable[str]:
    """Return the errors of a group and method in words, one unit for each metric."""
    errors: dict[str, str] = {}
    for (metric, unit), column in columns.items():
        # The last unit is that of the truth.
        if metric in SHORT_NAMES and unit != UNSTATED_UNIT and row in column:
            errors[metric] = (
                f"{SHORT_NAMES[metric]} {_describe_mean_and_median(column[row], unit)}"
            )
    return errors.values()


def _describe_mean_and_median(mean_and_median: Sequence[float], unit: str) -> str:
    """Return a mean and a median in words."""
    decimals = decimals_of(mean_and_median)
    mean, median = (format_number(value, decimals) for value in mean_and_median)
    return f"{mean} mean, {median} median ({unit})"


def sequences_of(report: Document, group: str, method: str) -> list[str]:
    """Return the sequences over which the mean of a method in a group is taken."""
    return [
        *dict.fromkeys(
            one.sequence
            for one in report["summaries"]
            if (one.group, one.method) == (group, method)
            and one.sequence is not None
            and one.images
        )
    ]


def _describe_images(report: Document, row: GroupMethod, images: int) -> str:
    """Say how many images a group and method have, and of how many sequences."""
    sequences = sequences_of(report, *row)
    if len(sequences) < 2:
        return counted(images, "image")
    return f"{images} images, means over {len(sequences)} sequences"


def _short_bars(
    columns: Mapping[Quantity, QuantityColumn], row: GroupMethod
) -> list[str]:
    """Return in words the coverage of the error bars of a group and method."""
    texts = []
    for quantity, text in (
        (BARS_50, "50% bars hold {:.0f}%"),
        (BARS_90, "90% bars hold {:.0f}%"),
        (RATIO, "expected / error {:.2f}"),
    ):
        if row in columns.get(quantity, {}):
            texts.append(text.format(*columns[quantity][row]))
    return texts


def markdown_table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a table in Markdown with aligned columns, the first to the left."""
    cells = [
        [" ".join(cell.split()).replace("|", "\\|") for cell in row]
        for row in (header, *rows)
    ]
    widths = [max(3, *map(len, column)) for column in zip(*cells, strict=True)]
    rule = ["-" * widths[0], *("-" * (width - 1) + ":" for width in widths[1:])]
    lines = []
    for first, *others in cells:
        right = [
            cell.rjust(width) for cell, width in zip(others, widths[1:], strict=True)
        ]
        lines.append([first.ljust(widths[0]), *right])
    lines.insert(1, rule)
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def format_number(value: float | None, decimals: int) -> str:
    """Return a number as text with `decimals` decimals; `ABSENT` for None and nan."""
    return ABSENT if value is None or math.isnan(value) else f"{value:.{decimals}f}"


def decimals_of(values: Iterable[float | None]) -> int:
    """Return how many decimals to show numbers with, by the largest of them.

    Three, as in the paper; one from 10 on, more for tiny numbers.
    """
    finite = (value for value in values if value is not None and not math.isnan(value))
    largest = max(finite, default=0.0)
    if largest >= 10:
        return 1
    if largest <= 0:
        return 3
    return max(3, 2 - math.floor(math.log10(largest)))
