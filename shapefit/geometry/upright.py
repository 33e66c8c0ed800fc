"""Which way is up, and frames in which that is y."""

from __future__ import annotations

from types import MappingProxyType
from typing import Literal

import numpy as np

from shapefit.arrays import Floats

Up = Literal["x", "y", "z", "-x", "-y", "-z"]

_ROWS: dict[Up, tuple[tuple[int, int, int], ...]] = {
    "x": ((0, -1, 0), (1, 0, 0), (0, 0, 1)),
    "y": ((1, 0, 0), (0, 1, 0), (0, 0, 1)),
    "z": ((1, 0, 0), (0, 0, 1), (0, -1, 0)),
    "-x": ((0, 1, 0), (-1, 0, 0), (0, 0, 1)),
    "-y": ((1, 0, 0), (0, -1, 0), (0, 0, -1)),
    "-z": ((1, 0, 0), (0, 0, -1), (0, 1, 0)),
}

TO_Y_UP = MappingProxyType({up: np.array(rows, np.float64) for up, rows in _ROWS.items()})
"""Rotations R (3, 3), det +1, with R a = y for the axis a that points up."""

IMAGE_UP: Up = "-y"
"""Of the frame x right, y down, z away from the camera, where the camera is held level."""


def nearest_axis_up(rotation: Floats) -> Up:
    """argmax over axes a of the world of <R a, up in the image>: the axis that points up.

    R (..., 3, 3) maps the world to the frame of the camera, x right, y down, z away from it. The
    cameras of a recording are rarely tilted by more than 45 degrees, and worlds have an axis
    upright; which one differs from tool to tool.
    """
    upward = -np.asarray(rotation, np.float64)[..., 1, :].reshape(-1, 3).mean(axis=0)
    axis = int(np.abs(upward).argmax())
    names: tuple[tuple[Up, Up], ...] = (("-x", "x"), ("-y", "y"), ("-z", "z"))
    return names[axis][int(upward[axis] > 0)]
