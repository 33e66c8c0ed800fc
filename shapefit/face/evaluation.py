"""A fit beside the truth, as the command `eval`."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from shapefit.config import EvalConfig
from shapefit.errors import input_error
from shapefit.evaluation.summaries import Summary, group_sequences, summarise
from shapefit.face.options import config_of, default
from shapefit.face.records import Fit, Shapes, result_set, shape_set
from shapefit.io.source import source_of
from shapefit.pipelines.evaluate.judge import Truth, judge

FILES = {"results": {"result": "-"}, "truth": (Path("truth"),), "output": Path("report")}
"""What stands for the files of the command in messages."""


@dataclass(frozen=True)
class Evaluation:
    """Errors of n images: errors maps a metric and its unit to (n,), nan where it is undefined.

    items and sequences (n); summaries as in report.csv: of the group `all`, or of each group, and
    of each sequence; failures maps the images without one or more errors to the reason.
    """

    items: tuple[str, ...]
    sequences: tuple[str, ...]
    errors: Mapping[tuple[str, str], NDArray[np.float64]]
    summaries: tuple[Summary, ...]
    failures: Mapping[str, str]

    def mean(self, metric: str, unit: str | None = None) -> float:
        """Return the mean over the groups' means in a metric, in its first unit if none is given.

        Raises ValueError where nothing was measured in it.
        """
        rows = [s for s in self.summaries if s.metric == metric and s.sequence is None]
        rows = [s for s in rows if s.unit == (unit or rows[0].unit)]
        if not rows:
            raise ValueError(f"no {metric} was measured" + (f" in {unit}" if unit else ""))
        return float(np.mean([row.mean for row in rows]))


def evaluate(
    result: Fit | Shapes | ArrayLike,
    truth: Shapes | ArrayLike,
    metrics: Sequence[str] = default(EvalConfig, "metrics"),
    match: str = default(EvalConfig, "match"),
    **options: Any,
) -> Evaluation:
    """Compare a fit with the true shapes; errors and sums equal those that `eval` writes.

    result: a Fit, or shapes (n, p, 3) from elsewhere; truth (n, p, 3), in the order of the images,
    or Shapes, matched by `match` and landmarks by name; metrics as of the command, those that the
    result lacks the datasets for left out with a warning; options are `groups`,
    `least_visible` and `rename`. Raises InputError.
    """
    given = {"metrics": metrics, "match": match}
    config = config_of(EvalConfig, "evaluate", given, options, FILES)
    if beyond := options.keys() - {"groups", "least_visible", "rename"}:
        fix = "use `groups`, `least_visible` or `rename`, or the command line"
        raise input_error(f"evaluate.{min(beyond)}", "is a key of reports only", fix)
    names = result.landmark_names if isinstance(result, Fit | Shapes) else None
    true_set = shape_set(truth, names)
    true = source_of(true_set, "truth", config.input.rename, gaps=True).whole()
    record = result_set(result, true.landmark_names)
    if not isinstance(truth, Shapes) or truth.items is None:
        if len(true) != len(record):
            found = f"has {len(true)} shapes for {len(record)} images"
            raise input_error("truth", found, "give one for each, or name them: Shapes(..., items)")
        true = type(true)(**{**vars(true), "items": record.items})
    asked = config.model_copy(update={"calibration": False})
    judged = judge(Path("result"), record, Truth(true, true.items, true.take), asked)
    errors = judged.image_errors("result")
    sequences = (name for each in errors for name in each.sequences.names)
    grouping, ungrouped = group_sequences(config.groups, sequences)
    for message in (*judged.warnings, *ungrouped):
        warnings.warn(message, stacklevel=2)
    return Evaluation(
        items=judged.items,
        sequences=judged.sequences,
        errors=judged.errors,
        summaries=tuple(s for e in errors for s in summarise(e, grouping)),
        failures=judged.failures,
    )
