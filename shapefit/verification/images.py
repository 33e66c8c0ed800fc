"""The landmarks of a result, weighted and normalised as its fit did it, with bounds on rounding."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Floats
from shapefit.errors import input_error
from shapefit.io import ResultSet
from shapefit.io.layout import LANDMARK_COVARIANCE
from shapefit.verification.check import largest, rounding_factor
from shapefit.verification.terms import Terms

FIX = "give a result that `shapefit fit` wrote"


@dataclass(frozen=True)
class Images:
    """n images with a shape: landmarks = size x points + centroid, at most points_error off.

    points V (n, 2, p), 0 where hidden; weights omega (n, p) of the convex program, inliers (n, p)
    those of what refines it; centroid (n, 2), size and lam (n,); extent (n,), the largest
    coordinate of the landmarks; factor (n,), see rounding_factor; points_error (n,).
    """

    points: Floats
    weights: Floats
    inliers: Floats
    centroid: Floats
    size: Floats
    lam: Floats
    extent: Floats
    factor: Floats
    points_error: Floats

    @property
    def reach(self) -> Floats:
        """Largest coordinate of the points (n,)."""
        return largest(np.abs(self.points))

    def judged_by_inliers(self) -> Images:
        """Return the images with the weights of what refines the program."""
        return replace(self, weights=self.inliers)


def read_images(
    result: ResultSet, rows: NDArray[np.intp], aside: NDArray[np.bool_], terms: Terms, file: Path
) -> Images:
    """Weigh and normalise the landmarks of the images `rows` (n,) of a result.

    omega is the confidence, 1 without one, if the loss is `exact` or where scores are but a limit,
    and 0 where a landmark is unseen or was set aside (p,) before the fit. The points have their
    centroid, over visible ones, at 0 and a mean over coordinates of 1 of the standard deviations.
    """
    raw = np.ascontiguousarray(stated_by(result, "landmarks", file)[rows].swapaxes(1, 2))
    seen = np.isfinite(raw[:, 0]) & np.isfinite(raw[:, 1]) & ~aside
    weights = np.where(seen, stated_confidence(result, file)[rows], 0.0)
    if terms.least_score is not None and LANDMARK_COVARIANCE not in result.columns:
        weights = ((weights > 0) & (weights >= terms.least_score)).astype(float)
    labelled = np.zeros(seen.shape, dtype=bool)
    if "outliers" in result.columns:
        labelled = stated_by(result, "outliers", file)[rows] != 0
    if terms.searched:
        weights = np.where(labelled, 0.0, weights)
    if terms.loss == "exact":
        weights = (weights > 0).astype(float)
    visible = weights > 0
    W = np.where(visible[:, None], raw, 0.0)
    count = np.maximum(visible.sum(axis=1), 1)[:, None]
    centroid = np.einsum("nap->na", W) / count
    centred = np.where(visible[:, None], W - centroid[..., None], 0.0)
    size = np.sqrt(np.einsum("nap,nap->na", centred, centred) / count).mean(axis=1)
    points = centred / size[:, None, None]
    counted = np.zeros(len(rows), dtype=np.int64)
    if result.transform_count is not None:
        counted = result.transform_count[rows]
    factor = rounding_factor(W.shape[2], counted)
    extent = largest(np.abs(W))
    reach = largest(np.abs(points))
    error = factor * (extent / size * (1 + 2 * reach) + reach)
    return Images(
        points=points,
        weights=weights,
        inliers=np.where(labelled, 0.0, weights),
        centroid=centroid,
        size=size,
        lam=stated_by(result, "lambda", file)[rows],
        extent=extent,
        factor=factor,
        points_error=error,
    )


def stated_by(result: ResultSet, name: str, file: Path) -> NDArray[Any]:
    """Return a dataset of the result, of numbers or texts, whose shape the reader has checked.

    Raises InputError where the file lacks it.
    """
    values = getattr(result, name, None)
    values = result.columns.get(name) if values is None else values
    if values is None:
        raise input_error(file, f"there is no dataset '{name}'", FIX)
    return np.asarray(values, np.float64 if values.dtype.kind in "biuf" else None)


def stated_confidence(result: ResultSet, file: Path) -> Floats:
    """Return the confidence (n, p) of the landmarks, 1 where the file has none.

    Raises InputError for one of another shape, as a dataset of the landmarks may have.
    """
    shape = (len(result), len(result.landmark_names))
    values = result.columns.get("confidence", np.ones(shape))
    if values.shape != shape or values.dtype.kind not in "biuf":
        found = f"holds {values.dtype} of the shape {values.shape}"
        raise input_error(f"{file}:/confidence", found, FIX)
    return values.astype(float)
