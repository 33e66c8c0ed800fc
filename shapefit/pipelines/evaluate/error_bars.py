"""The error bars of a result file against the truth."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from shapefit.arrays import Floats
from shapefit.errors import input_error
from shapefit.evaluation.averages import in_blocks
from shapefit.evaluation.calibration import ErrorBars, find_squares
from shapefit.evaluation.metric_table import CORRELATION, DEVIATION, TRUE_ROTATION
from shapefit.evaluation.report import NORMALISED
from shapefit.io.landmark_names import match_landmarks
from shapefit.io.records import ResultSet
from shapefit.pipelines.evaluate.judgement import Judgement
from shapefit.pipelines.evaluate.measurement import find_dataset

PAIRS = ((0, 1), (0, 2), (1, 2))
"""Coordinates of a landmark, in the order of the correlations."""

COVARIANCE = "shape_covariance"
"""Dataset (n, 3p, 3p) of x, y, z of one landmark after the other."""


def judge_error_bars(
    results: ResultSet, judgement: Judgement
) -> tuple[ErrorBars | None, tuple[str, ...]]:
    """Return how the truth lies in the error bars of a method's file, None where it has none.

    And a warning where it has some, but no `true_rotation`.
    """
    file = judgement.file
    deviation = find_dataset(file, results, DEVIATION)
    if deviation is None:
        return None, ()
    rotation = judgement.true_rotation
    if rotation is None:
        lacking = f"without the dataset `{TRUE_ROTATION.name}` or a `truth_frame`"
        return None, (f"{file}: the error bars are not judged, {lacking}",)
    correlation = find_correlation(file, results, deviation)
    own = match_landmarks(results.landmark_names, judgement.landmarks)
    with np.errstate(all="ignore"):  # overflow is not an error to report
        square, width = in_blocks(
            find_squares,
            judgement.estimate,
            judgement.true,
            rotation,
            deviation.take(own, axis=2),
            None if correlation is None else correlation.take(own, axis=2),
        )
        widths = {NORMALISED: width / judgement.scale[:, None], judgement.truth.unit: width}
    bars = ErrorBars(
        landmarks=judgement.landmarks,
        sequences=judgement.sequences,
        square=square,
        width=widths,
        parallel=correlation is None,
    )
    return bars, ()


def find_correlation(file: Path, results: ResultSet, deviation: Floats) -> Floats | None:
    """Correlations (n, 3, p) of each landmark: as they stand, or of the whole covariance, or None.

    Raises InputError where the covariance has another shape than the landmarks.
    """
    correlation = find_dataset(file, results, CORRELATION)
    covariance = results.columns.get(COVARIANCE)
    if correlation is not None or covariance is None:
        return correlation
    n, _, p = deviation.shape
    if np.shape(covariance) != (n, 3 * p, 3 * p):
        found = f"has the shape {np.shape(covariance)}"
        raise input_error(f"{file}:/{COVARIANCE}", found, f"its shape must be {(n, 3 * p, 3 * p)}")
    blocks = np.asarray(covariance, dtype=np.float64).reshape(n, p, 3, p, 3)
    own = np.einsum("npapb->nabp", blocks)
    sd = np.sqrt(np.einsum("naap->nap", own))
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.stack([own[:, a, b] / (sd[:, a] * sd[:, b]) for a, b in PAIRS], axis=1)
