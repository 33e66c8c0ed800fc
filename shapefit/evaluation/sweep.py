"""Errors against the values of one key that varied: the numbers as CSV, JSON and Markdown."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from shapefit.evaluation.metric_table import METRICS
from shapefit.evaluation.report import (
    ABSENT,
    HOW_TO_READ_PAIRS,
    as_json,
    as_markdown,
    markdown_table,
    pairs,
    table_text,
)
from shapefit.evaluation.summaries import ALL, ImageErrors, of_sequences, summarise, without_nan

Value = str | bool | int | float

_LABELS = (
    "Precision is the share of the landmarks labelled as outliers that were corrupted, recall the "
    "share of the corrupted landmarks that were labelled, over the images with a shape for which "
    "they are defined."
)
_TIMES = "Times are those of solving alone, without reading and writing, after one run to warm up."


@dataclass(frozen=True)
class Point:
    """Errors of one group of sequences in one metric at one value, and the time of an image.

    `images` have an error, `failed` ones have none; an image that leaves the metric undefined, as
    it can precision and recall, counts as neither.
    """

    value: Value
    group: str
    metric: str
    unit: str
    images: int
    failed: int
    mean: float
    p25: float
    median: float
    p75: float
    p90: float
    seconds_per_image: float


@dataclass(frozen=True)
class Sweep:
    """All points of a sweep over the values of `key`, value by value.

    `provenance` says how they were made (ready for JSON).
    """

    key: str
    points: tuple[Point, ...]
    provenance: Mapping[str, Any] = field(default_factory=dict)

    def of_metric(self) -> dict[tuple[str, str], dict[str, list[Point]]]:
        """Return the points of each metric and unit by group, in the order of the values."""
        metrics: dict[tuple[str, str], dict[str, list[Point]]] = {}
        for point in self.points:
            groups = metrics.setdefault((point.metric, point.unit), {})
            groups.setdefault(point.group, []).append(point)
        return metrics

    @property
    def is_numeric(self) -> bool:
        """Whether the values are numbers, so that they have a place on an axis."""
        return all(isinstance(point.value, int | float) for point in self.points) and not any(
            isinstance(point.value, bool) for point in self.points
        )


def points(
    value: Value,
    errors: ImageErrors,
    grouping: Mapping[str, Sequence[str]],
    seconds_per_image: float,
) -> list[Point]:
    """Sum up the errors in one metric at one value, one point per group.

    Every statistic of a group is the mean of that statistic over its sequences.
    """
    summaries = summarise(errors, grouping)
    quartiles = {
        name: np.percentile(known, (25, 75))
        for name, own in of_sequences(errors).items()
        if len(known := without_nan(own))
    }
    found = []
    for group in (summary for summary in summaries if summary.sequence is None):
        own = [quartiles[s] for s in grouping[group.group] if s in quartiles]
        p25, p75 = np.mean(own, axis=0) if own else (math.nan, math.nan)
        found.append(
            Point(
                value=value,
                group=group.group,
                metric=group.metric,
                unit=group.unit,
                images=group.images,
                failed=group.failed,
                mean=group.mean,
                p25=float(p25),
                median=group.median,
                p75=float(p75),
                p90=group.p90,
                seconds_per_image=seconds_per_image,
            )
        )
    return found


def value_text(value: Value) -> str:
    """Write a value as YAML has it: `false`, not `False`."""
    return str(value).lower() if isinstance(value, bool) else str(value)


COLUMNS = (
    "key", "value", "group", "metric", "unit", "images", "failed", "mean", "p25", "median", "p75",
    "p90", "seconds_per_image",
)  # fmt: skip


def write_csv(path: Path, sweep: Sweep) -> None:
    """Write sweep.csv, one row per value, group and metric; a missing number is an empty cell."""
    known = (
        {"key": sweep.key, **asdict(point), "value": value_text(point.value)}
        for point in sweep.points
    )
    rows = ([row[column] for column in COLUMNS] for row in known)
    path.write_text(table_text(COLUMNS, rows), encoding="utf-8")


def sweep_json(sweep: Sweep) -> str:
    """All numbers as JSON; null stands for a number that does not exist."""
    points = [asdict(point) for point in sweep.points]
    return as_json({"key": sweep.key, "points": points, **sweep.provenance})


def markdown(sweep: Sweep) -> str:
    """Return the page as Markdown."""
    return as_markdown(document(sweep))


def document(sweep: Sweep) -> list[str]:
    """One table: values down, mean and median of each group in each metric and the time across.

    Where images failed, the share of those that did not stands behind the errors of their group.
    """
    values = list(dict.fromkeys(point.value for point in sweep.points))
    columns: dict[str, dict[Value, str]] = {}
    for (metric, unit), groups in sweep.of_metric().items():
        for group, found in groups.items():
            of_which = "" if group == ALL else f"{group}: "
            at = [point.value for point in found]
            columns[f"{of_which}{metric} ({unit})"] = dict(zip(at, pairs(found), strict=True))
            if not METRICS[metric].of_labels and any(point.failed for point in found):
                shares = {point.value: _share_with_shape(point) for point in found}
                columns[f"{of_which}with a shape"] = shares
    columns["ms per image"] = {p.value: f"{1000 * p.seconds_per_image:.3g}" for p in sweep.points}
    rows = [
        [value_text(v), *(column.get(v, ABSENT) for column in columns.values())] for v in values
    ]
    parts: list[str] = [f"# Error against {sweep.key}", HOW_TO_READ_PAIRS]
    if any(METRICS[point.metric].of_labels for point in sweep.points):
        parts.append(_LABELS)
    parts += [markdown_table([sweep.key, *columns], rows), _TIMES]
    return parts


def _share_with_shape(point: Point) -> str:
    images = point.images + point.failed
    return f"{math.floor(100 * point.images / images + 1e-9)} %" if images else ABSENT
