"""The pinhole camera and its lens: what it sees of points, and which way depth runs.

Lens distortion is OpenCV's model. A point x, y of the image plane at distance 1 from
the camera, r^2 = x^2 + y^2, is seen at

    x g + 2 p1 x y + p2 (r^2 + 2 x^2),    y g + p1 (r^2 + 2 y^2) + 2 p2 x y,
    g = (1 + k1 r^2 + k2 r^4 + k3 r^6) / (1 + k4 r^2 + k5 r^4 + k6 r^6).

Coefficients are in OpenCV's order k1 k2 p1 p2 k3 k4 k5 k6; y points down, as in its
images.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from shapefit.arrays import Floats
from shapefit.geometry.normalisation import Normalised

CAMERA_MATRIX = "camera_matrix"
"""Dataset K (3, 3) or (n, 3, 3) of landmarks and of results."""

ASSUMED_FOCAL = 1.1
"""Focal length in longer sides of the image: an angle of view of 49 degrees across it.
With it the posterior does as well as with the true cameras of the man on the beam.
"""

ASSUMED_FOCAL_SD = 0.2
"""Deviation of the logarithm of an assumed focal length: lenses of 0.8 to 1.5."""

COEFFICIENTS = 8
"""Numbers that describe a lens."""

MAX_NEWTON_STEPS = 60
"""Of the way back through a lens."""

NEGLIGIBLE_LENGTH = 1e-12
"""Step, beside the distance from the axis, that changes nothing."""

PATH_STATIONS = 17
"""Points from the axis on at which a lens is checked not to bend back."""


@dataclass(frozen=True, eq=False, repr=False)
class Camera:
    """The pinhole cameras of n images: u = centre + focal X_xy / (sign X_z).

    focal (n, 2) > 0 and centre (n, 2), in the unit of the landmarks they go with. sign
    is +1 where z points away from the camera (y of the landmarks down), -1 where it
    points to it (y up). focal_sd, the standard deviation of the logarithm of the focal
    length: 0 where it was measured.
    """

    focal: Floats
    centre: Floats
    sign: float
    focal_sd: float = 0.0

    def take(self, images: NDArray[np.intp]) -> Camera:
        """Return the cameras of the images with these indices."""
        return replace(self, focal=self.focal[images], centre=self.centre[images])

    def normalised_as(self, landmarks: Normalised) -> Camera:
        """Return the cameras in the unit and origin of normalised landmarks."""
        size = landmarks.scale[:, None]
        centre = (self.centre - landmarks.centroid) / size
        return replace(self, focal=self.focal / size, centre=centre)


def project_pinhole(camera: Camera, points: Floats) -> Floats:
    """Project points (n, 3, p) to images (n, 2, p): centre + focal X_xy / (sign X_z).

    The points are in the frames of the cameras; nan for a point that is not in front of
    its camera.
    """
    depth = camera.sign * points[:, 2:]
    depth = np.where(depth > 0, depth, np.nan)
    return camera.centre[..., None] + camera.focal[..., None] * points[:, :2] / depth


def depth_sign(y_axis: Literal["up", "down"] | None) -> float:
    """Return `Camera.sign`: 1 where z points away from the camera (y down), else -1.

    z is the cross product of x and y; y points down by default.
    """
    return -1.0 if y_axis == "up" else 1.0


def complete_coefficients(coefficients: Sequence[float] | Floats) -> Floats:
    """Pad the distortion coefficients of lenses with zeros: 4, 5 or 8 -> (..., 8).

    Raises ValueError for other numbers of coefficients.
    """
    given = np.asarray(coefficients, dtype=np.float64)
    if given.shape[-1] not in (4, 5, COEFFICIENTS):  # more are a thin prism and tilt
        raise ValueError(f"{given.shape[-1]} coefficients of distortion, not 4, 5 or 8")
    absent = np.zeros((*given.shape[:-1], COEFFICIENTS - given.shape[-1]))
    return np.concatenate([given, absent], axis=-1)


def undistort(points: Floats, coefficients: Floats) -> Floats:
    """Undo a lens's distortion of points (..., 2, p) in the image plane at distance 1.

    coefficients (..., 8). Newton's method finds the points along the path from the axis
    on which the lens turns nothing over. NaN where there are none: the model bends back
    before that.
    """
    undistorted = np.array(points, dtype=np.float64)
    size = np.maximum(np.linalg.norm(undistorted, axis=-2), NEGLIGIBLE_LENGTH)
    with np.errstate(all="ignore"):
        for _ in range(MAX_NEWTON_STEPS):
            reached, across, along, skew = distort(undistorted, coefficients)
            x, y = np.moveaxis(points - reached, -2, 0)
            step_x = along * x - skew * y
            step_y = across * y - skew * x
            step = np.stack([step_x, step_y], axis=-2)
            step /= (across * along - skew**2)[..., None, :]
            # at most half of the way to the axis, which Newton's step may overshoot
            longest = np.maximum(np.linalg.norm(undistorted, axis=-2), size)
            length = np.linalg.norm(step, axis=-2)
            share = 0.5 * longest / np.maximum(length, NEGLIGIBLE_LENGTH)
            step *= np.minimum(1.0, share)[..., None, :]
            undistorted = undistorted + step
            if not (length > NEGLIGIBLE_LENGTH * longest).any():
                break
        reached = distort(undistorted, coefficients)[0]
        is_right = np.linalg.norm(points - reached, axis=-2) <= 1e-9 * size
        # nor does the lens bend back on the way there
        for share in np.linspace(0.0, 1.0, PATH_STATIONS):
            _, across, along, skew = distort(share * undistorted, coefficients)
            is_right &= (across > 0) & (across * along > skew**2)
    return np.where(is_right[..., None, :], undistorted, np.nan)


def distort(
    points: Floats, coefficients: Floats
) -> tuple[Floats, Floats, Floats, Floats]:
    """Distort points (..., 2, p); return x' and y', dx'/dx, dy'/dy and dx'/dy (..., p).

    The points x, y are those of the image plane at distance 1; coefficients (..., 8).
    dy'/dx = dx'/dy, since the model is the gradient of a function of the plane.
    """
    each = np.moveaxis(coefficients, -1, 0)[..., None]
    k1, k2, p1, p2, k3, k4, k5, k6 = each
    x = points[..., 0, :]
    y = points[..., 1, :]
    r2 = x * x + y * y
    above = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    below = 1 + r2 * (k4 + r2 * (k5 + r2 * k6))
    gain = above / below
    # d gain / d r^2
    slope_above = k1 + r2 * (2 * k2 + 3 * r2 * k3)
    slope_below = k4 + r2 * (2 * k5 + 3 * r2 * k6)
    slope = (slope_above - gain * slope_below) / below
    moved_x = x * gain + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
    moved_y = y * gain + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
    across = gain + 2 * slope * x * x + 2 * p1 * y + 6 * p2 * x
    along = gain + 2 * slope * y * y + 6 * p1 * y + 2 * p2 * x
    skew = 2 * slope * x * y + 2 * p1 * x + 2 * p2 * y
    return np.stack([moved_x, moved_y], axis=-2), across, along, skew


def is_assumed_focal(focal: ArrayLike, size: ArrayLike) -> bool:
    """Whether focal lengths are what is assumed for images of this size, in pixels.

    Both of any shape; the largest of each counts. False where there are none.
    """
    if not np.size(focal) or not np.size(size):
        return False
    return bool(np.isclose(np.max(focal), ASSUMED_FOCAL * np.max(size)))
