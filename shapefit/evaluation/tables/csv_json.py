"""The tables of an evaluation as CSV and JSON."""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from types import SimpleNamespace
from typing import Any, TypeVar

from shapefit.evaluation.calibration import LEVELS, Coverage, Kept
from shapefit.evaluation.report import Report
from shapefit.evaluation.summary import ImageErrors, Summary


def write_table(path: Path, columns: Sequence[str], rows: Iterable[Iterable[Any]]) -> None:
    """Write a header and rows; None and nan become empty cells."""
    with path.open("w", newline="", encoding="utf-8") as file:
        # A writer that ends its lines in CR LF puts cells with a CR in quotes, others do not.
        table = csv.writer(SimpleNamespace(write=lambda line: file.write(f"{line[:-2]}\n")))
        table.writerow(columns)
        # Nan alone is not equal to itself; to ask millions of cells for their type takes long.
        table.writerows([value if value == value else None for value in row] for row in rows)


def _null_for_nan(value: Any) -> Any:
    """Return None in place of nan, as JSON and CSV have it."""
    return None if isinstance(value, float) and math.isnan(value) else value


Errors = TypeVar("Errors", Summary, ImageErrors)

INSIDE = tuple(f"inside_{100 * level:.0f}" for level in LEVELS)
COVERAGE = ("method", "group", "landmark", "judged", *INSIDE, "median_width", "unit")
KEPT = ("method", "metric", "group", "images", "mean", "kept", "mean_kept", "plausibility", "unit")
REPORT = ("method", "metric", "group", "sequence", "images", "mean", "median", "p90", "unit")


def write_report_csv(path: Path, summaries: Sequence[Summary]) -> None:
    """Write report.csv, one row per group (its `sequence` is empty) and one per sequence."""
    write_table(path, REPORT, ([getattr(s, name) for name in REPORT] for s in summaries))


def write_coverage(path: Path, coverage: Sequence[Coverage]) -> None:
    """Write calibration.csv, one row per group (its `landmark` is empty), landmark and unit."""
    rows = (
        (c.method, c.group, c.landmark, c.judged, *c.inside, width, unit)
        for c in coverage
        for unit, width in c.median_width.items()
    )
    write_table(path, COVERAGE, rows)


def write_kept(path: Path, kept: Sequence[Kept]) -> None:
    """Write trusted.csv, one row per method, metric, unit and group."""
    write_table(path, KEPT, ([getattr(k, name) for name in KEPT] for k in kept))


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
                "solving": asdict(method.solving),
            }
            for method in report.methods
        ],
        "summaries": [asdict(s) for s in report.summaries],
        "calibration": [asdict(c) for c in report.coverage],
        "trusted": [asdict(k) for k in report.kept],
        "without_error_bars": report.without_bars,
        "parallel_error_bars": report.parallel,
        "published": {method: dict(column) for method, column in report.published.items()},
        "caveats": report.caveats,
        "warnings": report.warnings,
        **report.provenance,
    }
    return as_json(document)


def as_json(document: Mapping[str, Any]) -> str:
    """Return numbers as JSON; null stands for a number that does not exist."""
    return json.dumps(_nulls(document), indent=2, ensure_ascii=False, allow_nan=False) + "\n"


def _nulls(fields: Any) -> Any:
    """Put null in place of nan, throughout."""
    if isinstance(fields, Mapping):
        return {key: _nulls(value) for key, value in fields.items()}
    if isinstance(fields, list | tuple):
        return [_nulls(value) for value in fields]
    return _null_for_nan(fields)


def by_kind(errors: Iterable[Errors]) -> dict[tuple[str, str], list[Errors]]:
    """Collect summaries or errors by metric and unit, in order of first appearance."""
    collected: dict[tuple[str, str], list[Errors]] = {}
    for entry in errors:
        collected.setdefault((entry.metric, entry.unit), []).append(entry)
    return collected
