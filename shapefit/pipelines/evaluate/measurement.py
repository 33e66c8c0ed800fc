"""From the arrays of a result to its errors in one metric, in its unit or two."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Floats
from shapefit.evaluation import metrics as measures
from shapefit.evaluation.metric_table import (
    BOX,
    ESTIMATE,
    IMAGE,
    LANDMARKS,
    LENGTH,
    METRICS,
    TRUTH,
    Dataset,
)
from shapefit.evaluation.report import NORMALISED

Kind = tuple[str, str]
"""A metric and its unit."""

OF_THE_BOX = "box"
"""Unit of distances in an image as shares of the diagonal of the object's box."""


def datasets_of(metric: str) -> tuple[Dataset, ...]:
    """Return all datasets of a result file that a metric can take; those in an image also a box."""
    known = METRICS[metric]
    return (*known.datasets, *((LANDMARKS, BOX) if known.unit == IMAGE else ()))


def measure(
    metric: str,
    estimate: Floats,
    true: Floats,
    data: Mapping[Dataset, NDArray[Any] | None],
    units: tuple[str, str],
) -> dict[Kind, Floats]:
    """Errors (n,) in one metric, in one unit or two.

    estimate and true (n, 3, p); data holds the datasets of the metric, all that it needs; units
    are those of the truth and of the images.
    """
    known = METRICS[metric]
    arrays = {**data, ESTIMATE: estimate, TRUTH: true}
    error: Floats = known.load()(*(arrays[dataset] for dataset in known.needs))
    if known.unit == LENGTH:
        return in_both_units(metric, error, estimate, true, units[0])
    if known.unit != IMAGE:
        return {(metric, known.unit): error}
    boxed = error / _diagonal(arrays[BOX], arrays[LANDMARKS])
    return {(metric, units[1]): error, (metric, OF_THE_BOX): boxed}


def in_both_units(
    metric: str, error: Floats, estimate: Floats, true: Floats, unit: str
) -> dict[Kind, Floats]:
    """Return an error in the unit of the truth both normalised by the true shape and as it is.

    A truth whose own unit is `normalised` is given once.
    """
    normalised = error / measures.truth_scale(estimate, true)
    return {(metric, NORMALISED): normalised} | (
        {} if unit == NORMALISED else {(metric, unit): error}
    )


def _diagonal(boxes: NDArray[Any] | None, observed: NDArray[Any] | None) -> Floats:
    """Diagonal (n,) of the given boxes (n, 4), x y w h, else of those of the observed landmarks.

    nan where it is 0 or unknown.
    """
    if boxes is None:
        assert observed is not None  # a metric in an image takes them
        return measures.box_diagonal(observed)
    diagonal = np.hypot(boxes[:, 2], boxes[:, 3])
    return np.where(diagonal > 0, diagonal, np.nan)
