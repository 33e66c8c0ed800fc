"""Meshes to test with: a box."""

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from shapefit.arrays import Floats


@pytest.fixture
def box() -> Callable[[float, float, float], Floats]:
    """Return the function that gives the corners (3, 8) of a box around the origin.

    Corner i lies high on x, y and z where the bits 4, 2 and 1 of i are set.
    """
    corners = np.array([[i >> 2 & 1, i >> 1 & 1, i & 1] for i in range(8)]) - 0.5
    return lambda width, height, depth: (corners * (width, height, depth)).T


@pytest.fixture
def box_faces() -> NDArray[np.int64]:
    """Return two triangles a side, wound outwards."""
    return np.array(
        [
            (0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5), (0, 4, 5), (0, 5, 1),
            (2, 3, 7), (2, 7, 6), (0, 2, 6), (0, 6, 4), (1, 5, 7), (1, 7, 3),
        ]
    )  # fmt: skip
