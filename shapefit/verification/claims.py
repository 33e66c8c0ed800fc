"""Claims of n images, those that are false, and the ranges of datasets."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from shapefit.arrays import Flags, Floats

TOLERANCE = 1e-9
"""Share of its size by which a number may be off from the one that is computed again."""
ORTHONORMAL = 1e-8
"""By which entries of R^T R may differ from those of the identity."""

Columns = Mapping[str, NDArray[Any]]
"""Datasets of n images by name; points one a column, (n, 3, p) or (n, 2, p)."""

WITHOUT_SHAPE = ("degenerate input", "numerical failure")
STATUS = ("optimal", "converged", "iteration limit")

RANGES: Mapping[tuple[float, float], str] = {
    (np.nextafter(0.0, 1.0), np.inf): "scale lambda metres_per_unit focal",
    (0.0, np.inf): "shape_sd input_shape_sd active_atoms iterations residual expected_error "
    "image_error",
    (0.0, 1.0): "p_value inlier_probability trusted tight outliers",
    (-1.0 - 2.0**-23, 1.0 + 2.0**-23): "shape_correlation input_shape_correlation",  # single
    (-np.inf, np.inf): "shapes input_shapes landmarks_fitted coefficients translation objective "
    "log_evidence camera_translation principal_point shape_covariance",
}
"""(least, greatest) -> datasets with numbers in this range, all finite."""
MAY_LACK = (
    "p_value inlier_probability metres_per_unit residual objective lambda landmarks_fitted "
    "coefficients expected_error focal camera_translation principal_point"
)
"""Datasets that may be nan where there is a shape."""


class Claims:
    """What is claimed of n images, of which `fitted` (n,) have a shape.

    missed (n,): the images for which a claim is false; reasons: the first such claim of each.
    """

    def __init__(self, fitted: Flags) -> None:
        self.fitted = fitted
        self.missed: Flags = np.zeros_like(fitted)
        self.reasons: dict[int, str] = {}

    def near(
        self, text: str, off: Floats, allowed: ArrayLike = TOLERANCE, of: Flags | None = None
    ) -> None:
        """Claim that differences (n, ...) are at most `allowed` (n,), and not nan.

        of (n,): the images of which it is claimed, by default those with a shape.
        """
        off = largest(np.asarray(off, dtype=np.float64))
        false = (self.fitted if of is None else of) & ~(off <= np.asarray(allowed))
        for image in np.flatnonzero(false & ~self.missed).tolist():
            self.reasons[image] = f"not true: {text}; off by {off[image]:.2g}"
        self.missed |= false

    def hold(self, text: str, holds: ArrayLike, of: Flags | None = None) -> None:
        """Claim what holds or not (n, ...), with nothing between."""
        self.near(text, np.where(holds, 0.0, np.inf), 0.0, of)


def largest(values: Floats) -> Floats:
    """Return the largest number of each image (n,) of values (n, ...); nan where one is nan."""
    if values.ndim == 1:
        return values
    # Along the images, which is quicker than within one.
    rows = np.ascontiguousarray(np.moveaxis(values, 0, -1))
    return np.asarray(rows.max(axis=tuple(range(rows.ndim - 1)), initial=-np.inf))


def check_ranges(columns: Columns, claims: Claims) -> None:
    """Claim that numbers are in their range, rotations proper, shapes whole or absent."""
    lacking = MAY_LACK.split()
    for (low, high), names in RANGES.items():
        for name in columns.keys() & set(names.split()):
            values = np.asarray(columns[name], dtype=np.float64)
            fine = (values >= low) & (values <= high) & np.isfinite(values)
            fine |= np.isnan(values) & (name in lacking)
            claims.hold(f"{name} is in its range", fine)
    everyone = np.ones_like(claims.fitted)
    absent = np.isnan(columns["shapes"]).all(axis=(1, 2))
    claims.hold("a shape is whole or absent", absent | claims.fitted, of=everyone)
    words = columns["status"].astype(str)
    right = np.where(claims.fitted, np.isin(words, STATUS), np.isin(words, WITHOUT_SHAPE))
    claims.hold("the status says whether there is a shape", right, of=everyone)
    R = columns["rotation"]
    stated = np.asarray(~np.isnan(R).all(axis=(1, 2)))
    off = np.abs(R.swapaxes(1, 2) @ R - np.eye(3))
    claims.near("the rotation is orthonormal", off, ORTHONORMAL, of=stated)
    claims.hold("the rotation is proper", np.linalg.det(R) > 0, of=stated)
