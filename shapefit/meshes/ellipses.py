"""Error bars as they look in a picture: the ellipses of one standard deviation."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Floats
from shapefit.meshes.views import YAxis, upright


class Ellipses(NamedTuple):
    """Semi-axes (p, 2), the longer one first, and the angle (p,) of that to x, in radians."""

    semi_axes: Floats
    angle: Floats


def covariances(deviation: Floats, correlation: Floats | None = None) -> Floats:
    """C (..., p, 3, 3) of each landmark from deviations and correlations (..., 3, p).

    The correlations are those of x with y, x with z, and y with z; none for axes of the camera.
    """
    sd = np.swapaxes(deviation, -1, -2)
    K = np.zeros((*sd.shape, 3))
    K[..., (0, 1, 2), (0, 1, 2)] = 1.0
    if correlation is not None:
        for row, (a, b) in enumerate(((0, 1), (0, 2), (1, 2))):
            K[..., a, b] = K[..., b, a] = correlation[..., row, :]
    found: Floats = sd[..., :, None] * K * sd[..., None, :]
    return found


def seen_ellipses(covariance: Floats, rotation: Floats, y_axis: YAxis) -> Ellipses:
    """Outlines of one standard deviation in a view: of (V C V^T) in x and y, V the view.

    covariance C (p, 3, 3) in the camera frame, rotation (3, 3) of the viewer's frame. nan where a
    landmark has none.
    """
    V = rotation @ upright(np.eye(3), y_axis)
    C = (V @ covariance @ V.T)[:, :2, :2]
    known: NDArray[np.bool_] = np.asarray(np.isfinite(C).all(axis=(1, 2)))
    squares, axes = np.linalg.eigh(np.where(known[:, None, None], C, 0.0))
    lengths = np.sqrt(np.maximum(squares[:, ::-1], 0.0))
    angle = np.arctan2(axes[:, 1, 1], axes[:, 0, 1])
    return Ellipses(np.where(known[:, None], lengths, np.nan), np.where(known, angle, np.nan))
