"""Landmarks of a file as a camera without the distortion of its lens sees them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Floats
from shapefit.geometry.lens import complete, distort, undistort

REMOVED = "removed_distortion"
"""Dataset of a result: the coefficients of the distortion that its landmarks no longer have."""

BOUND = 1e-8
"""Of the largest coordinate by which the inverse of the model may miss."""


def bent_again(stated: Floats, extras: Mapping[str, Any], y_axis: str) -> Floats:
    """Return landmarks (n, p, 2) of a result where its lens puts them: those of the file."""
    coefficients, focal, centre = _lens(extras, y_axis)
    return centre + focal * _through(distort, (stated - centre) / focal, coefficients)


def shown(given: Floats, extras: Mapping[str, Any], y_axis: str) -> NDArray[np.bool_]:
    """Whether the lens puts some point of the scene at each landmark (n, p, 2) of the file."""
    coefficients, focal, centre = _lens(extras, y_axis)
    straight = _through(undistort, (given - centre) / focal, coefficients)
    return np.asarray(np.isfinite(straight).all(axis=2))


def _lens(extras: Mapping[str, Any], y_axis: str) -> tuple[Floats, Floats, Floats]:
    """Return coefficients (..., 8), and focal lengths and centres, (..., 1, 2)."""
    matrix = np.asarray(extras["camera_matrix"], dtype=np.float64)
    coefficients = complete(np.asarray(extras[REMOVED], dtype=np.float64))
    if y_axis == "up":
        coefficients = coefficients * np.array([1.0, 1.0, -1.0, 1.0, 1.0, 1.0, 1.0, 1.0])
    focal = np.stack([matrix[..., 0, 0], matrix[..., 1, 1]], axis=-1)
    return coefficients, focal[..., None, :], matrix[..., None, :2, 2]


def _through(lens: Any, points: Floats, coefficients: Floats) -> Floats:
    every = np.broadcast_to(coefficients, (len(points), coefficients.shape[-1]))
    moved: Floats = lens(points.swapaxes(1, 2), every).swapaxes(1, 2)
    return moved
