"""`evaluate` on arrays: the pipeline of `eval`, with the same numbers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from shapefit.api.arguments import Metric, config_of, with_suggestions
from shapefit.api.learning import as_shapes
from shapefit.api.messages import warn, with_names
from shapefit.arrays import Floats
from shapefit.config.commands.others import EvalConfig
from shapefit.errors import counted, input_error
from shapefit.evaluation.report import ErrorSummary, group_sequences, summarise_errors
from shapefit.io.source import source_of
from shapefit.pipelines.evaluate.measure import measure
from shapefit.records import Fit, Shapes

FILES = {
    "results": {"result": (Path("result"),)},
    "truth": (Path("truth"),),
    "output": Path("report"),
}
"""Keys of the command whose place arrays take, and what stands for them in messages."""

BARS = ("shape_sd", "shape_correlation", "shape_covariance", "p_value")
"""What the calibration of a report judges beside the errors."""


@dataclass(frozen=True, eq=False, repr=False)
class Evaluation:
    """Errors of n images, and their summaries.

    Attributes
    ----------
    items, sequences : tuple of str, of length n
        Names of the images and of their sequences.
    errors : mapping of (metric, unit) to array of shape (n,)
        NaN where a metric is undefined.
    summaries : tuple of ErrorSummary
        The rows of report.csv: of the group `all` or of each group, and of each
        sequence.
    failures : mapping of str to str
        Images that lack an error, and why.

    """

    items: tuple[str, ...]
    sequences: tuple[str, ...]
    errors: Mapping[tuple[str, str], Floats]
    summaries: tuple[ErrorSummary, ...]
    failures: Mapping[str, str]

    def mean(self, metric: Metric, unit: str | None = None) -> float:
        """Return the mean error in a metric: of each group, then over the groups.

        Parameters
        ----------
        metric : str
            What was measured.
        unit : str
            By default the first unit in which it was measured.

        Returns
        -------
        float

        Raises
        ------
        ValueError
            Where nothing was measured in this metric and unit.

        """
        rows = [s for s in self.summaries if s.metric == metric and s.sequence is None]
        rows = [s for s in rows if s.unit == (unit or rows[0].unit)]
        if not rows:
            raise ValueError(
                f"no {metric} was measured" + (f" in {unit}" if unit else "")
            )
        return float(np.mean([row.mean for row in rows]))

    def __repr__(self) -> str:
        parts = [counted(len(self.items), "image")]
        for metric, unit in self.errors:
            means = [
                row.mean
                for row in self.summaries
                if (row.metric, row.unit, row.sequence) == (metric, unit, None)
            ]
            if means:
                parts.append(f"{metric} {np.mean(means):.3g} {unit}")
        if self.failures:
            parts.append(f"{len(self.failures)} without an error")
        return f"<shapefit.Evaluation: {', '.join(parts)}>"


@with_suggestions
def evaluate(
    result: Fit | Shapes | ArrayLike,
    truth: Shapes | ArrayLike,
    metrics: Sequence[Metric] | None = None,
    match: str | None = None,
    *,
    groups: Mapping[str, str] | None = None,
    least_visible: int | None = None,
    rename: Mapping[str, str] | None = None,
) -> Evaluation:
    """Compare a fit with the true shapes; errors and summaries equal those of `eval`.

    Parameters
    ----------
    result : Fit, Shapes, or array of shape (n, p, 3)
        What is judged.
    truth : Shapes, or array of shape (n, p, 3)
        True shapes; those of an array are in the order of the images.
    metrics : sequence of str
        What to measure; what the result lacks the datasets for is left out with a
        warning.
    match : str
        What identifies the true shape of an image: "item", "frame" or a dataset.
    groups : mapping of str to str
        Groups of sequences to average over: name -> glob.
    least_visible : int
        Minimum number of visible landmarks of an image.
    rename : mapping of str to str
        Landmarks of the truth to rename: name there -> name in the result.

    Returns
    -------
    Evaluation

    Raises
    ------
    InputError
        For every wrong argument at once, with what to give instead.

    """
    given = {
        "metrics": metrics,
        "match": match,
        "groups": groups,
        "least_visible": least_visible,
        "rename": rename,
    }
    config = config_of("evaluate", EvalConfig, given, FILES)
    if isinstance(result, Fit):
        estimated = result
    else:
        shapes = as_shapes(result)
        estimated = replace(Fit.of_shapes(shapes), extras=shapes.extras)
    true = _named_truth(estimated, as_shapes(truth), config.rename)
    record = with_names(estimated, true.landmark_names).without(BARS)
    measured = measure(Path("result"), record, true, config)
    grouping = group_sequences(config.groups, measured.sequences)
    warn(measured.warnings)
    return Evaluation(
        items=measured.items,
        sequences=measured.sequences,
        errors=measured.errors,
        summaries=tuple(
            summarise_errors("result", measured.sequences, measured.errors, grouping)
        ),
        failures=measured.failures,
    )


def _named_truth(estimated: Fit, true: Shapes, rename: Mapping[str, str]) -> Shapes:
    """Rename landmarks of the true shapes; give shapes without items the images' ones.

    Raises InputError where they have no names and are not as many.
    """
    has_items = bool(true.items)
    names = true.landmark_names or estimated.landmark_names
    if names:
        true = with_names(true, names)
    true = source_of(true.named(), "truth", rename, gaps=True).whole()
    if has_items:
        return true
    if len(true) != len(estimated):
        fault = f"has {len(true)} shapes for {len(estimated)} images"
        fix = "give one for each, or name them: Shapes(..., items)"
        raise input_error("truth", fault, fix)
    return replace(true, items=estimated.named().items)
