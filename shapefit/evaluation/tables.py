"""The tables of an evaluation as CSV, JSON and Markdown."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from shapefit.evaluation.markdown import markdown_table
from shapefit.evaluation.report import PUBLISHED, Report
from shapefit.evaluation.solving import Solving
from shapefit.evaluation.summary import ImageErrors, Summary

if TYPE_CHECKING:
    import polars

Errors = TypeVar("Errors", Summary, ImageErrors)

PER_IMAGE = ("method", "sequence", "item", "metric", "error", "unit")
REPORT = ("method", "metric", "group", "sequence", "images", "mean", "median", "p90", "unit")

FAILURES_SHOWN = 10
"""Failed items a method that the Markdown lists; the JSON lists them all."""

ABSENT = "–"
"""Cell of a number that does not exist."""

_HOW_TO_READ = (
    "Each number is the mean, over the sequences of the group, of the sequence's mean error."
)
_HOW_TO_READ_SOLVING = (
    "Means over all images, as the result files tell them. Objectives of different models cannot "
    "be compared: the convex program minimises another than the methods that share one rotation "
    "(convex+refine, alternate, alternate+), and pmp and mean-shape each one of their own; all "
    "depend on lambda and the dictionary. Times are those of the machine and the threads of each "
    "fit, solving alone."
)
_QUOTED = "Columns in italics are quoted from their publication, not computed here."


def write_per_image(path: Path, errors: Sequence[ImageErrors]) -> None:
    """Write per_image.csv, one row an image, metric and unit; a failed image's error is empty."""
    import polars as pl

    pl.concat([_per_image(e) for e in errors]).write_csv(path)


def _per_image(errors: ImageErrors) -> polars.DataFrame:
    import polars as pl

    table = pl.DataFrame(
        {"sequence": errors.sequences, "item": errors.items, "error": errors.values}
    )
    labels = [pl.lit(getattr(errors, name)).alias(name) for name in ("method", "metric", "unit")]
    return table.with_columns(pl.col("error").fill_nan(None), *labels).select(PER_IMAGE)


def write_report_csv(path: Path, summaries: Sequence[Summary]) -> None:
    """Write report.csv, one row a group (its `sequence` is empty) and one a sequence."""
    import polars as pl

    table = pl.DataFrame([asdict(s) for s in summaries], infer_schema_length=None)
    table.select(REPORT).with_columns(pl.col(pl.Float64).fill_nan(None)).write_csv(path)


def report_json(report: Report) -> str:
    """All numbers of the report as JSON; null stands for a number that does not exist."""
    document = {
        "methods": [
            {
                "name": method.name,
                "files": method.files,
                "images": method.images,
                "failed": len(method.failures),
                "failures": [{"item": i, "reason": r} for i, r in method.failures.items()],
                "solving": asdict(method.solving),
            }
            for method in report.methods
        ],
        "summaries": [
            {key: _null_for_nan(value) for key, value in asdict(s).items()}
            for s in report.summaries
        ],
        "published": {method: dict(column) for method, column in report.published.items()},
        "caveats": report.caveats,
        "warnings": report.warnings,
        **report.provenance,
    }
    return json.dumps(document, indent=2, ensure_ascii=False, allow_nan=False) + "\n"


def markdown(report: Report) -> str:
    """One table a metric and unit, groups down and methods across, then counts and notes."""
    tables = by_kind(report.summaries)
    parts = ["# Errors against the truth", _HOW_TO_READ]
    if report.published and PUBLISHED in tables:
        parts.append(_QUOTED)
    for kind, summaries in tables.items():
        published = report.published if kind == PUBLISHED else {}
        parts += [f"## {kind[0]} ({kind[1]})", _errors_table(summaries, published)]
    parts += ["## Images", _images_table(report), *_failed_items(report)]
    parts += _solving(report)
    parts += _listing("Left out", report.warnings)
    parts += _listing("Caveats", report.caveats)
    return "\n\n".join(parts) + "\n"


def by_kind(errors: Iterable[Errors]) -> dict[tuple[str, str], list[Errors]]:
    """Collect summaries or errors by metric and unit, in order of first appearance."""
    collected: dict[tuple[str, str], list[Errors]] = {}
    for entry in errors:
        collected.setdefault((entry.metric, entry.unit), []).append(entry)
    return collected


def _errors_table(
    summaries: Sequence[Summary], published: Mapping[str, Mapping[str, float]]
) -> str:
    ours = {(s.group, s.method): s.mean for s in summaries if s.sequence is None}
    quoted = {(g, m): error for m, column in published.items() for g, error in column.items()}
    groups = dict.fromkeys(group for group, _ in (*ours, *quoted))
    methods = dict.fromkeys(method for _, method in ours)
    decimals = _decimals([*ours.values(), *quoted.values()])

    def number(value: float | None) -> str:
        return ABSENT if value is None or math.isnan(value) else f"{value:.{decimals}f}"

    header = ["", *methods, *(f"*{method}*" for method in published)]
    rows = [
        [
            group,
            *(number(ours.get((group, method))) for method in methods),
            *(number(quoted.get((group, method))) for method in published),
        ]
        for group in groups
    ]
    return markdown_table(header, rows)


def _images_table(report: Report) -> str:
    counts = [(m.name, m.images, len(m.failures)) for m in report.methods]
    rows = [[name, str(n - failed), str(failed)] for name, n, failed in counts]
    return markdown_table(["method", "evaluated", "failed"], rows)


def _solving(report: Report) -> list[str]:
    """The table of what the fits tell of themselves, unless they tell nothing, as CSV files."""
    told = [(method.name, method.solving) for method in report.methods]
    if all(solving == Solving() for _, solving in told):
        return []
    decimals = _decimals(s.mean_objective for _, s in told if s.mean_objective is not None)
    header = ["method", "mean objective", "ms an image", "optimal or converged"]
    rows = [
        [
            name,
            ABSENT if s.mean_objective is None else f"{s.mean_objective:.{decimals}f}",
            ABSENT if s.milliseconds is None else f"{s.milliseconds:.3g}",
            ABSENT if s.solved is None else _percent(s.solved),
        ]
        for name, s in told
    ]
    return ["## Solving", _HOW_TO_READ_SOLVING, markdown_table(header, rows)]


def _percent(share: float) -> str:
    """Say 100 % only where it is all of them: digits are cut off, not rounded up."""
    return f"{math.floor(10000 * share + 1e-9) / 100:.2f} %"


def _failed_items(report: Report) -> list[str]:
    lines = []
    for method in report.methods:
        failures = list(method.failures.items())
        lines += [f"{method.name}, {item}: {why}" for item, why in failures[:FAILURES_SHOWN]]
        if len(failures) > FAILURES_SHOWN:
            more = len(failures) - FAILURES_SHOWN
            lines.append(f"{method.name}: {more} more, all listed in report.json")
    return _listing("Failed", lines)


def _listing(title: str, lines: Sequence[str]) -> list[str]:
    return [f"## {title}", "\n".join(f"- {line}" for line in lines)] if lines else []


def _decimals(values: Iterable[float]) -> int:
    """Digits after the point: three as in the paper, one from 10 on, more for tiny numbers."""
    largest = max((value for value in values if not math.isnan(value)), default=0.0)
    if largest >= 10:
        return 1
    return max(3, 2 - math.floor(math.log10(largest))) if largest > 0 else 3


def _null_for_nan(value: Any) -> Any:
    return None if isinstance(value, float) and math.isnan(value) else value
