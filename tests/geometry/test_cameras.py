"""Cameras: known points and views, the turntable, and OpenCV's lens against its own
inverse.
"""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from shapefit.geometry import pinhole
from shapefit.geometry.cameras import (
    TO_Y_UP,
    nearest_axis_up,
    project_from_afar,
    turntable,
)
from shapefit.geometry.pinhole import Camera, complete_coefficients, distort, undistort

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


@pytest.mark.parametrize("scale", [1.0, 250.0])
def test_a_camera_far_away_keeps_x_and_y_but_for_their_scale(scale):
    assert np.array_equal(
        project_from_afar(POINTS, np.eye(3), scale) / scale, POINTS[:2]
    )


@pytest.mark.parametrize("up", ["x", "y", "z"])
def test_the_turntable_starts_upright_and_turns_anticlockwise(up):
    start, quarter = project_from_afar(POINTS, turntable(np.array([0, 0.25]), up))
    assert_allclose(start, START[up], atol=1e-12)
    assert_allclose(quarter, QUARTER[up], atol=1e-12)


AXES = {"x": 0, "y": 1, "z": 2}


@pytest.mark.parametrize("up", TO_Y_UP)
def test_the_axis_becomes_y_by_a_rotation(up):
    R = TO_Y_UP[up]
    axis = np.eye(3)[AXES[up[-1]]] * (-1 if up.startswith("-") else 1)
    assert_array_equal(R @ axis, [0, 1, 0])
    assert_array_equal(R @ R.T, np.eye(3))
    assert np.linalg.det(R) == 1


@pytest.mark.parametrize("up", TO_Y_UP)
@pytest.mark.parametrize("tilt", [-40, 0, 40])
def test_the_world_axis_nearest_to_up_in_the_image(up, tilt):
    c, s = np.cos(np.radians(tilt)), np.sin(np.radians(tilt))
    level = np.diag([1.0, -1.0, -1.0]) @ TO_Y_UP[up]  # y up -> x right, y down, z away
    pitch = np.array([[1, 0, 0], [0, c, -s], [0, s, c]])
    assert nearest_axis_up(pitch @ level) == up
    assert nearest_axis_up(np.stack([pitch @ level] * 2)) == up


LENSES = {
    "barrel": [-0.3, 0.1, 0.001, -0.002],
    "pincushion": [0.19, -0.28, -0.0024, 0.0028, 0.1475],
    "rational": [0.2, -0.1, 0.001, 0.002, 0.05, 0.1, 0.02, 0.001],
    "telephoto": [-58.19, 0.0, 0.0, 0.0, 0.0],
}


def opencv(x, y, k1, k2, p1, p2, k3=0.0, k4=0.0, k5=0.0, k6=0.0):
    """The formula of OpenCV's documentation of calib3d, point by point, in complex
    numbers.

    With z = x + iy the radial part is z g, and the tangential one (p2 + i p1) |z|^2 +
    2 z Re(z (p2 - i p1)) = 3-term form of (2 p1 x y + p2 (r^2 + 2 x^2), ...).
    """
    z, p = complex(x, y), complex(p2, p1)
    r2 = abs(z) ** 2
    gain = sum(k * r2**i for i, k in enumerate((1, k1, k2, k3)))
    gain /= sum(k * r2**i for i, k in enumerate((1, k4, k5, k6)))
    moved = z * gain + p * r2 + 2 * z * (z * p.conjugate()).real
    return moved.real, moved.imag


@pytest.mark.parametrize("name", LENSES)
def test_forward_and_back(rng, name):
    lens = LENSES[name]
    reach = 0.03 if name == "telephoto" else 0.7
    points = rng.uniform(-reach, reach, (3, 2, 50))
    moved = distort(points, complete_coefficients(lens))[0]
    known = [[opencv(x, y, *lens) for x, y in image.T] for image in points]
    assert_allclose(moved.swapaxes(1, 2), known, atol=1e-14)
    assert_allclose(undistort(moved, complete_coefficients(lens)), points, atol=1e-12)


def test_where_the_lens_bends_back_there_is_no_point():
    """1 - 0.3 r^2 turns over at r = 1.054, where the lens reaches 0.7027."""
    points = np.array([[0.70, 0.71, -5.0, np.nan], [0.0, 0.0, 0.0, 0.0]])
    found = undistort(points, complete_coefficients([-0.3, 0, 0, 0]))
    assert np.isfinite(found[:, 0]).all()
    assert found[0, 0] < np.sqrt(1 / 0.9)
    assert np.isnan(found[:, 1:]).all()


def test_large_points_are_undistorted_to_their_own_precision():
    """The residual that counts as none grows with the points."""
    points, lens = (
        np.array([[1e4, -2e4, 3e3], [1e3, 7e3, -9e3]]),
        complete_coefficients([1e-10, 1e-20, 0, 0]),
    )
    assert_allclose(undistort(distort(points, lens)[0], lens), points, rtol=1e-12)


def test_zero_distortion_and_other_counts(rng):
    points = rng.normal(size=(2, 2, 5))
    assert_array_equal(
        undistort(points, complete_coefficients([0, 0, 0, 0, 0])), points
    )
    with pytest.raises(ValueError, match="3 coefficients"):
        complete_coefficients([0.1, 0.2, 0.3])


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_points_before_the_camera_are_seen_however_near(sign):
    z = np.array([1e-3, 0.3, 50.0, 0.0, -2.0])
    points = np.stack([np.full(5, 0.2), np.full(5, -0.1), sign * z])[None]
    camera = Camera(np.full((1, 2), 800.0), np.array([[320.0, 240.0]]), sign)
    visible = pinhole.project_pinhole(camera, points)
    expected = np.array([320 + 160 / z[:3], 240 - 80 / z[:3]])
    assert_allclose(visible[0, :, :3], expected)
    assert np.isnan(visible[0, :, 3:]).all()
