"""The pinhole camera: what it sees of points, and which way depth runs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Floats
from shapefit.geometry.normalisation import Normalised

Rows = NDArray[np.intp]


@dataclass(frozen=True)
class Camera:
    """u = centre + focal X_xy / (sign X_z) for n images: focal (n, 2) > 0, centre (n, 2).

    In the unit of the landmarks they go with. sign is +1 where z points away from the camera (y of
    the landmarks down), -1 where it points to it (y up).
    """

    focal: Floats
    centre: Floats
    sign: float

    def take(self, images: Rows) -> Camera:
        """Keep some of the images."""
        return Camera(self.focal[images], self.centre[images], self.sign)

    def normalised_as(self, landmarks: Normalised) -> Camera:
        """Return the camera that sees the same as normalised landmarks."""
        size = landmarks.scale[:, None]
        return Camera(self.focal / size, (self.centre - landmarks.centroid) / size, self.sign)


def project(camera: Camera, points: Floats) -> Floats:
    """u = centre + focal X_xy / (sign X_z): points (n, 3, p) in the camera's frame -> (n, 2, p).

    nan for a point that is not in front of the camera.
    """
    depth = camera.sign * points[:, 2:]
    depth = np.where(depth > 0, depth, np.nan)
    return camera.centre[..., None] + camera.focal[..., None] * points[:, :2] / depth


def depth_sign(y_axis: Literal["up", "down"]) -> float:
    """+1 where z, the cross product of x and y, points away from the camera, else -1."""
    return 1.0 if y_axis == "down" else -1.0
