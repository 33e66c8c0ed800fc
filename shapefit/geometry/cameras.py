"""Cameras far from the object: weak perspective, the turntable, and which way is up."""

from __future__ import annotations

from types import MappingProxyType
from typing import Literal

import numpy as np

from shapefit.arrays import Floats
from shapefit.geometry.rotations import rotation_about

Up = Literal["x", "y", "z", "-x", "-y", "-z"]

_ROWS: dict[Up, tuple[tuple[int, int, int], ...]] = {
    "x": ((0, -1, 0), (1, 0, 0), (0, 0, 1)),
    "y": ((1, 0, 0), (0, 1, 0), (0, 0, 1)),
    "z": ((1, 0, 0), (0, 0, 1), (0, -1, 0)),
    "-x": ((0, 1, 0), (-1, 0, 0), (0, 0, 1)),
    "-y": ((1, 0, 0), (0, -1, 0), (0, 0, -1)),
    "-z": ((1, 0, 0), (0, 0, -1), (0, 1, 0)),
}

TO_Y_UP = MappingProxyType(
    {up: np.array(rows, np.float64) for up, rows in _ROWS.items()}
)
"""Rotations R (3, 3), det +1, with R a = y for the axis a that points up."""

IMAGE_UP: Up = "-y"
"""Of the frame x right, y down, z away from the camera, where the camera is held level.
"""


def nearest_axis_up(world_to_camera: Floats) -> Up:
    """Return the signed axis of the world that is nearest to up in the images.

    argmax_a <R a, up in the image>. The rotations R (..., 3, 3) map the world to the
    frame of the camera: x right, y down, z away from it. The cameras of a recording are
    rarely tilted by more than 45 degrees, and worlds have an axis upright; which one
    differs from tool to tool.
    """
    downward = np.asarray(world_to_camera, np.float64)[..., 1, :].reshape(-1, 3)
    upward = -downward.mean(axis=0)
    axis = int(np.abs(upward).argmax())
    positive: tuple[Up, ...] = ("x", "y", "z")
    negative: tuple[Up, ...] = ("-x", "-y", "-z")
    return positive[axis] if upward[axis] > 0 else negative[axis]


Axis = Literal["x", "y", "z"]


def project_from_afar(shapes: Floats, rotations: Floats, scale: float = 1.0) -> Floats:
    """Rotate shapes (..., 3, p) and project them under weak perspective to (..., 2, p).

    W = s [1 0 0; 0 1 0] R S, which a far camera sees; rotations R (..., 3, 3). s = 1 is
    the orthographic camera, any other positive s the weak-perspective one.
    Rotations map object frame to camera frame: x right, y up, z towards the viewer.
    """
    return scale * (rotations[..., :2, :] @ shapes)


def turntable(turns: Floats, up: Axis) -> Floats:
    """Return object-to-camera rotations (n, 3, 3) for whole turns (n,) about axis `up`.

    R = U R_up(2 pi turns). Turns may be fractions. The object is upright and has turned
    about its axis `up`. The camera is level. U brings the axis `up` of the object to y
    of the camera by the shorter way; it is the identity for y. Seen from above the
    object turns anticlockwise.
    """
    axis = np.eye(3)["xyz".index(up)]
    return TO_Y_UP[up] @ rotation_about(axis, 2 * np.pi * np.asarray(turns))
