"""Cameras: known points, known views, and the full turn of the turntable."""

import numpy as np
import pytest

from shapefit.geometry.cameras import TO_Y_UP, nearest_axis_up, project, turntable

# One point on each axis of the object, and one off all of them.
POINTS = np.array([[1.0, 0, 0, 1], [0, 2, 0, 2], [0, 0, 3, 3]])

# Where a quarter turn, anticlockwise from above, brings the axes of an upright object.
QUARTER = {
    "y": [[0, 0, 3, 3], [0, 2, 0, 2]],  # z to the right, y up
    "z": [[0, -2, 0, -2], [0, 0, 3, 3]],  # y to the left, z up
    "x": [[0, 0, 3, 3], [1, 0, 0, 1]],  # z to the right, x up
}
START = {
    "y": [[1, 0, 0, 1], [0, 2, 0, 2]],  # x to the right, y up
    "z": [[1, 0, 0, 1], [0, 0, 3, 3]],  # x to the right, z up
    "x": [[0, -2, 0, -2], [1, 0, 0, 1]],  # y to the left, x up
}


def test_the_orthographic_camera_keeps_x_and_y():
    assert np.array_equal(project(POINTS, np.eye(3)), [[1, 0, 0, 1], [0, 2, 0, 2]])


def test_the_weak_perspective_camera_scales_the_picture():
    assert np.array_equal(project(POINTS, np.eye(3), 250.0), [[250, 0, 0, 250], [0, 500, 0, 500]])


@pytest.mark.parametrize("up", ["x", "y", "z"])
def test_the_turntable_starts_upright_and_turns_anticlockwise(up):
    start, quarter = project(POINTS, turntable(np.array([0, 0.25]), up))
    np.testing.assert_allclose(start, START[up], atol=1e-12)
    np.testing.assert_allclose(quarter, QUARTER[up], atol=1e-12)


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
