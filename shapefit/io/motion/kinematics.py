"""Forward kinematics: from angles at the joints of a tree to the places of its points."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


def turn(axis: int, angles: Floats) -> Floats:
    """Return the rotations (n, 3, 3) by angles (n,), in radians, about x, y or z (0, 1, 2)."""
    cosine, sine = np.cos(angles), np.sin(angles)
    rotation = np.zeros((*angles.shape, 3, 3))
    a, b = (axis + 1) % 3, (axis + 2) % 3
    rotation[..., axis, axis] = 1.0
    rotation[..., a, a] = rotation[..., b, b] = cosine
    rotation[..., a, b], rotation[..., b, a] = -sine, sine
    return rotation


def turns(axes: Sequence[int], angles: Floats) -> Floats:
    """R = R_1 R_2 ...: rotations (n, 3, 3) about these axes by angles (n, len(axes)) in radians.

    The last one turns first, as the channels of BVH do; Acclaim lists them the other way round.
    """
    rotation = np.broadcast_to(np.eye(3), (*angles.shape[:-1], 3, 3))
    for place, axis in enumerate(axes):
        rotation = rotation @ turn(axis, angles[..., place])
    return rotation
