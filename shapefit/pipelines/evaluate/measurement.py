"""From the datasets of a result file to its errors: what each metric takes, and its units."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shapefit.evaluation import labels
from shapefit.evaluation import metrics as measures
from shapefit.evaluation.report import NORMALISED
from shapefit.geometry.rotations import rotation_angle

Floats = NDArray[np.float64]
Kind = tuple[str, str]
"""A metric and its unit."""

BOX = "box"
"""Unit of distances in an image as shares of the diagonal of the object's box."""

NEEDS: Mapping[str, tuple[str, ...]] = {
    "similarity": (),
    "camera": ("true_rotation",),
    "rotation": ("true_rotation", "rotation"),
    "reprojection": ("landmarks", "landmarks_fitted"),
    "precision": ("outliers", "corrupted"),
    "recall": ("outliers", "corrupted"),
}
"""Datasets of the result file, besides the shapes, that each metric takes."""

USES: Mapping[str, tuple[str, ...]] = {"reprojection": ("bounding_box",)}
"""Datasets that a metric takes where they are there."""


def datasets_of(metric: str) -> tuple[str, ...]:
    """Return the names of all datasets that a metric can take."""
    return NEEDS[metric] + USES.get(metric, ())


def measure(
    metric: str,
    estimate: Floats,
    true: Floats,
    data: Mapping[str, NDArray[Any] | None],
    units: tuple[str, str],
) -> dict[Kind, Floats]:
    """Errors (n,) in one metric, in one unit or two.

    estimate and true (n, 3, p); data holds the datasets of the metric by name, all that it needs;
    units are those of the truth and of the images.
    """
    needed: list[Any] = [data[name] for name in NEEDS[metric]]
    if metric == "rotation":
        return {(metric, "deg"): rotation_angle(*needed)}
    if metric == "reprojection":
        observed, fitted = needed
        error = measures.reprojection(fitted, observed)
        return {
            (metric, units[1]): error,
            (metric, BOX): error / _diagonal(data["bounding_box"], observed),
        }
    if metric in labels.METRICS:
        share = labels.precision if metric == "precision" else labels.recall
        return {(metric, labels.SHARE): share(*needed)}
    distance = measures.camera if metric == "camera" else measures.similarity
    return in_both_units(metric, distance(estimate, true, *needed), estimate, true, units[0])


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


def _diagonal(boxes: NDArray[Any] | None, observed: Floats) -> Floats:
    """Diagonal (n,) of the given boxes (n, 4), x y w h, else of those of the observed landmarks.

    nan where it is 0 or unknown.
    """
    if boxes is None:
        return measures.box_diagonal(observed)
    diagonal = np.hypot(boxes[:, 2], boxes[:, 3])
    return np.where(diagonal > 0, diagonal, np.nan)
