"""Errors against the values of one key that varied: the numbers as CSV, JSON and Markdown."""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from shapefit.evaluation.markdown import markdown_table
from shapefit.evaluation.summary import ImageErrors, summarise

Value = str | bool | int | float

_HOW_TO_READ = (
    "Similarity errors of normalised shapes. Each number is the mean, over the sequences of the "
    "group, of the sequence's mean (median, quartile, 90th percentile)."
)
_LABELS = (
    "Precision is the share of the landmarks labelled as outliers that were made wrong, recall the "
    "share of those made wrong that are labelled: means over the images with a shape that leave "
    "them defined."
)
_TIMES = (
    "Times are of solving alone, without reading and writing, after everything was compiled and "
    "run once."
)


@dataclass(frozen=True)
class Point:
    """Errors of one group of sequences at one value, and the time an image took to solve.

    `images` have an error, `failed` ones have none; precision and recall of the outlier labels
    are nan where nobody knows them.
    """

    value: Value
    group: str
    images: int
    failed: int
    mean: float
    p25: float
    median: float
    p75: float
    p90: float
    seconds_per_image: float
    precision: float = math.nan
    recall: float = math.nan


@dataclass(frozen=True)
class Sweep:
    """All points of a sweep over the values of `key`, value by value.

    `provenance` says how they were made (ready for JSON).
    """

    key: str
    points: tuple[Point, ...]
    caveats: tuple[str, ...] = ()
    provenance: Mapping[str, Any] = field(default_factory=dict)

    def of_group(self) -> dict[str, list[Point]]:
        """Return the points of each group, in the order of the values."""
        groups: dict[str, list[Point]] = {}
        for point in self.points:
            groups.setdefault(point.group, []).append(point)
        return groups

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
    labels: Sequence[ImageErrors] = (),
) -> list[Point]:
    """Sum up the errors at one value, one point a group.

    Every statistic of a group is the mean of that statistic over its sequences. `labels` are the
    precision and the recall of the outlier labels, where they are known.
    """
    summaries = summarise(errors, grouping)
    means = {
        (summary.metric, summary.group): summary.mean
        for shares in labels
        for summary in summarise(shares, grouping)
        if summary.sequence is None
    }
    quartiles = {
        s: np.nanpercentile(errors.values[np.array(errors.sequences) == s], [25, 75])
        for s in {summary.sequence for summary in summaries if summary.images}
        if s is not None
    }
    found = []
    for group in (summary for summary in summaries if summary.sequence is None):
        own = [quartiles[s] for s in grouping[group.group] if s in quartiles]
        p25, p75 = np.mean(own, axis=0) if own else (math.nan, math.nan)
        found.append(
            Point(
                value=value,
                group=group.group,
                images=group.images,
                failed=group.failed,
                mean=group.mean,
                p25=float(p25),
                median=group.median,
                p75=float(p75),
                p90=group.p90,
                seconds_per_image=seconds_per_image,
                precision=means.get(("precision", group.group), math.nan),
                recall=means.get(("recall", group.group), math.nan),
            )
        )
    return found


COLUMNS = (
    "key", "value", "group", "images", "failed", "mean", "p25", "median", "p75", "p90",
    "seconds_per_image", "precision", "recall",
)  # fmt: skip


def write_csv(path: Path, sweep: Sweep) -> None:
    """Write sweep.csv, one row a value and group; a number that does not exist is empty."""
    with path.open("w", newline="", encoding="utf-8") as file:
        rows = csv.DictWriter(file, COLUMNS, lineterminator="\n")
        rows.writeheader()
        rows.writerows({"key": sweep.key, **_known(point)} for point in sweep.points)


def sweep_json(sweep: Sweep) -> str:
    """All numbers as JSON; null stands for a number that does not exist."""
    document = {
        "key": sweep.key,
        "points": [_known(point) for point in sweep.points],
        "caveats": sweep.caveats,
        **sweep.provenance,
    }
    return json.dumps(document, indent=2, ensure_ascii=False, allow_nan=False) + "\n"


def markdown(sweep: Sweep) -> str:
    """One table: values down, mean and quartiles of each group and the time across.

    Where outliers were looked for, the share of images with a shape and the precision and recall
    of the labels stand beside the errors.
    """
    groups = sweep.of_group()
    labelled = any(not math.isnan(point.precision) for point in sweep.points)
    header = [sweep.key]
    for group in groups:
        header += [group, "quartiles"]
        header += ["median", "with a shape", "precision", "recall"] if labelled else []
    header.append("ms an image")
    rows = []
    for at in zip(*groups.values(), strict=True):
        row = [str(at[0].value)]
        for point in at:
            row += [f"{point.mean:.3f}", f"{point.p25:.3f} to {point.p75:.3f}"]
            row += _labels(point) if labelled else []
        rows.append([*row, f"{1000 * at[0].seconds_per_image:.3g}"])
    parts = [f"# Error against {sweep.key}", _HOW_TO_READ, markdown_table(header, rows), _TIMES]
    if labelled:
        parts.insert(2, _LABELS)
    if sweep.caveats:
        parts += ["## Caveats", "\n".join(f"- {caveat}" for caveat in sweep.caveats)]
    return "\n\n".join(parts) + "\n"


def _labels(point: Point) -> list[str]:
    """Cells of the median, the share of images with a shape, precision and recall."""
    images = point.images + point.failed
    share = f"{100 * point.images / images:.0f}%" if images else "-"
    known = ["-" if math.isnan(x) else f"{x:.2f}" for x in (point.precision, point.recall)]
    return [f"{point.median:.3f}", share, *known]


def _known(point: Point) -> dict[str, Any]:
    return {
        key: None if isinstance(value, float) and math.isnan(value) else value
        for key, value in asdict(point).items()
    }
