"""What is claimed of n images, and which of them miss it; the ranges of datasets."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from shapefit.arrays import Flags, Floats

TOLERANCE = 1e-9
"""Share of its size by which a number may be off from the one that is computed again."""
SINGLE = 2.0**-23
"""Rounding of numbers that are stored in single precision."""
ORTHONORMAL = 1e-8
"""By which entries of R^T R may differ from those of the identity."""

Columns = Mapping[str, NDArray[Any]]
"""Datasets of n images by name; points one a column, (n, 3, p) or (n, 2, p)."""

WITHOUT_SHAPE = ("degenerate input", "numerical failure")
STATUS = ("optimal", "converged", "iteration limit")


class Claim(NamedTuple):
    """A claim of the images `made` (n,): `off` (n,) is at most `allowed` (n,), and not nan."""

    text: str
    off: Floats
    allowed: Floats
    made: Flags

    @property
    def missed(self) -> Flags:
        """The images (n,) for which the claim is false."""
        return np.asarray(self.made & ~(self.off <= self.allowed))

    def reason(self, image: int) -> str:
        """Say how one image misses the claim."""
        if not np.isfinite(self.off[image]):
            return f"not true: {self.text}"
        return f"not true: {self.text}; off by {self.off[image]:.2g}"


@dataclass
class Claims:
    """The claims of n images, of which `fitted` (n,) have a shape."""

    fitted: Flags
    made: list[Claim] = field(default_factory=list)

    def near(
        self, text: str, off: Floats, allowed: ArrayLike = TOLERANCE, of: Flags | None = None
    ) -> None:
        """Claim that differences (n, ...) are at most `allowed` (n,), of the images with a shape.

        of (n,): the images of which it is claimed instead.
        """
        off = largest(np.asarray(off, dtype=np.float64))
        limits = np.broadcast_to(np.asarray(allowed, dtype=np.float64), off.shape)
        self.made.append(Claim(text, off, limits, self.fitted if of is None else of))

    def hold(self, text: str, holds: ArrayLike, of: Flags | None = None) -> None:
        """Claim what holds or not (n, ...), with nothing between."""
        self.near(text, np.where(holds, 0.0, np.inf), 0.0, of)

    @property
    def missed(self) -> Flags:
        """The images (n,) for which some claim is false."""
        return np.any([np.zeros_like(self.fitted), *(each.missed for each in self.made)], axis=0)

    def reasons(self) -> Iterator[tuple[int, str]]:
        """Yield each image with a false claim, and its first one."""
        for image in np.flatnonzero(self.missed).tolist():
            first, *more = (each for each in self.made if each.missed[image])
            yield image, first.reason(image) + (f" (and {len(more)} more)" if more else "")


def largest(values: Floats) -> Floats:
    """Return the largest number of each image (n,) of values (n, ...); nan where one is nan."""
    if values.ndim == 1:
        return values
    # Along the images, which is quicker than within one.
    rows = np.ascontiguousarray(np.moveaxis(values, 0, -1))
    return np.asarray(rows.max(axis=tuple(range(rows.ndim - 1)), initial=-np.inf))


ABOVE_0 = np.nextafter(0.0, 1.0)
RANGES: Mapping[tuple[float, float], str] = {
    (ABOVE_0, np.inf): "scale lambda metres_per_unit focal",
    (0.0, np.inf): "shape_sd input_shape_sd active_atoms iterations residual expected_error "
    "image_error",
    (0.0, 1.0): "p_value inlier_probability trusted tight outliers",
    (-1.0 - SINGLE, 1.0 + SINGLE): "shape_correlation input_shape_correlation",
    (-np.inf, np.inf): "shapes input_shapes landmarks_fitted coefficients translation objective "
    "log_evidence camera_translation principal_point shape_covariance",
}
"""(least, greatest) -> datasets with numbers in this range, all finite."""
MAY_LACK = {"p_value", "inlier_probability", "metres_per_unit", "residual", "objective", "lambda"}
MAY_LACK |= {"landmarks_fitted", "coefficients", "expected_error"}
MAY_LACK |= {"focal", "camera_translation", "principal_point"}
"""Datasets that may be nan where there is a shape."""


def check_ranges(columns: Columns, claims: Claims) -> None:
    """Claim that numbers are in their range, rotations proper, shapes whole or absent."""
    for (low, high), names in RANGES.items():
        for name in names.split():
            if name not in columns:
                continue
            values = np.asarray(columns[name], dtype=np.float64)
            fine = (values >= low) & (values <= high) & np.isfinite(values)
            if name in MAY_LACK:
                fine |= np.isnan(values)
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
