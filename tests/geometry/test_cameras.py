"""Cameras: known points, known views, and the full turn of the turntable."""

import numpy as np
import pytest

from shapefit.geometry.cameras import project, turntable

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
