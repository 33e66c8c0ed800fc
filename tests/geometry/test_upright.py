"""Frames with y up are turned, not mirrored, and the axis that points up is found."""

import numpy as np
import pytest

from shapefit.geometry.cameras import TO_Y_UP, nearest_axis_up

AXES = {"x": 0, "y": 1, "z": 2}


@pytest.mark.parametrize("up", TO_Y_UP)
def test_the_axis_becomes_y_by_a_rotation(up):
    R = TO_Y_UP[up]
    axis = np.eye(3)[AXES[up[-1]]] * (-1 if up.startswith("-") else 1)
    np.testing.assert_array_equal(R @ axis, [0, 1, 0])
    np.testing.assert_array_equal(R @ R.T, np.eye(3))
    assert np.linalg.det(R) == 1


@pytest.mark.parametrize("up", TO_Y_UP)
@pytest.mark.parametrize("tilt", [-40, 0, 40])
def test_the_world_axis_nearest_to_up_in_the_image(up, tilt):
    c, s = np.cos(np.radians(tilt)), np.sin(np.radians(tilt))
    level = np.diag([1.0, -1.0, -1.0]) @ TO_Y_UP[up]  # y up -> x right, y down, z away
    pitch = np.array([[1, 0, 0], [0, c, -s], [0, s, c]])
    assert nearest_axis_up(pitch @ level) == up
    assert nearest_axis_up(np.stack([pitch @ level] * 2)) == up
