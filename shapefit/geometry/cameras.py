"""Cameras far from the object: orthographic and weak-perspective projection, the turntable."""

from __future__ import annotations

from typing import Literal

import numpy as np

from shapefit.arrays import Floats
from shapefit.geometry.rotations import rotation_about
from shapefit.geometry.upright import TO_Y_UP

Axis = Literal["x", "y", "z"]


def project(shapes: Floats, rotations: Floats, scale: float = 1.0) -> Floats:
    """W = s [1 0 0; 0 1 0] R S; shapes (..., 3, p), rotations (..., 3, 3) -> (..., 2, p).

    s = 1 is the orthographic camera, any other positive s the weak-perspective one. Rotations
    map object frame to camera frame: x right, y up, z towards the viewer.
    """
    return scale * (rotations[..., :2, :] @ shapes)


def turntable(turns: Floats, up: Axis) -> Floats:
    """R = U R_up(2 pi turns): the object stands upright and has made `turns` turns about `up`.

    turns (n,) -> (n, 3, 3). The camera looks horizontally. U brings the axis `up` of the object
    to y of the camera by the shorter way; it is the identity for y. Seen from above the object
    turns anticlockwise.
    """
    axis = np.eye(3)["xyz".index(up)]
    return TO_Y_UP[up] @ rotation_about(axis, 2 * np.pi * np.asarray(turns))
