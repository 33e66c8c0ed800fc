"""Where a picture is seen from: the viewer's frame is x right, y up, z towards the viewer."""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np

from shapefit.arrays import Floats
from shapefit.geometry.rotations import rotation_about

YAxis = Literal["up", "down"]


class View(NamedTuple):
    """Walk around the shape by `turn` and rise above it by `tilt` degrees; (0, 0) stays."""

    turn: float
    tilt: float

    def rotation(self) -> Floats:
        """Return the rotation (3, 3) of the viewer's frame that gives this view."""
        x, y, _ = np.eye(3)
        tilt = rotation_about(x, np.radians([self.tilt]))[0]
        return tilt @ rotation_about(y, np.radians([self.turn]))[0]


def upright(points: Floats, y_axis: YAxis) -> Floats:
    """From the camera frame to the viewer's: half a turn about x where y points down.

    points (..., 3, p), or landmarks (..., 2, p). The camera frame is landmark x, landmark y and
    their cross product, so z points away from the viewer where y points down. Half a turn is no
    reflection: a mesh keeps its winding.
    """
    if y_axis == "up":
        return points
    return points * np.array([1.0, -1.0, -1.0])[: points.shape[-2], None]


def level(up: Floats) -> Floats:
    """Rotation (3, 3) of the viewer's frame after which `up` is y, seen from the same side.

    up (3,), a direction in the viewer's frame. Takes the tilt out of a view and keeps its turn:
    what faced the viewer still does. Seen straight from above, the lower side of the picture comes
    to face the viewer; straight from below, the upper one.
    """
    y = up / np.linalg.norm(up)
    facing = np.array([0.0, 0.0, 1.0])
    if abs(y[2]) > 1 - 1e-9:
        facing = np.array([0.0, -y[2], 0.0])
    z = facing - (facing @ y) * y
    z /= np.linalg.norm(z)
    return np.stack([np.cross(y, z), y, z])
