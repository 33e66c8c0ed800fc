"""Cameras: known points and views, the turntable, and OpenCV's lens against its own
inverse.
"""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from shapefit.geometry.cameras import (
    TO_Y_UP,
    nearest_axis_up,
    project_from_afar,
    turntable,
)
from shapefit.geometry.normalisation import normalise
from shapefit.geometry.pinhole import (
    ASSUMED_FOCAL,
    Camera,
    complete_coefficients,
    depth_sign,
    distort,
    is_assumed_focal,
    project_pinhole,
    undistort,
)
from shapefit.geometry.rotations import rotation_about_axis
from tests.points import transpose

POINTS = np.array([[1.0, 0, 0, 1], [0, 2, 0, 2], [0, 0, 3, 3]])
"""One point on each axis of the object, and one off all of them."""

QUARTER = {
    "y": [[0, 0, 3, 3], [0, 2, 0, 2]],  # z to the right, y up
    "z": [[0, -2, 0, -2], [0, 0, 3, 3]],  # y to the left, z up
    "x": [[0, 0, 3, 3], [1, 0, 0, 1]],  # z to the right, x up
}
"""Where a quarter turn, anticlockwise from above, brings the axes of an upright
object.
"""

START = {
    "y": [[1, 0, 0, 1], [0, 2, 0, 2]],  # x to the right, y up
    "z": [[1, 0, 0, 1], [0, 0, 3, 3]],  # x to the right, z up
    "x": [[0, -2, 0, -2], [1, 0, 0, 1]],  # y to the left, x up
}


@pytest.mark.parametrize("scale", [1.0, 250.0])
def test_a_camera_far_away_keeps_x_and_y_but_for_their_scale(scale):
    landmarks = project_from_afar(POINTS, np.eye(3), scale)
    assert_array_equal(landmarks / scale, POINTS[:2])


@pytest.mark.parametrize("up", ["x", "y", "z"])
def test_the_turntable_starts_upright_and_turns_anticlockwise(up):
    views = turntable(np.array([0, 0.25]), up)
    start, quarter = project_from_afar(POINTS, views)
    assert_allclose(start, START[up], atol=1e-12)
    assert_allclose(quarter, QUARTER[up], atol=1e-12)


AXES = {"x": [1, 0, 0], "y": [0, 1, 0], "z": [0, 0, 1]}


@pytest.mark.parametrize("up", TO_Y_UP)
def test_the_axis_becomes_y_by_a_rotation(up):
    R = TO_Y_UP[up]
    axis = np.array(AXES[up[-1]])
    if up.startswith("-"):
        axis = -axis
    assert_array_equal(R @ axis, [0, 1, 0])
    assert_array_equal(R @ R.T, np.eye(3))
    assert np.linalg.det(R) == 1


@pytest.mark.parametrize("up", TO_Y_UP)
@pytest.mark.parametrize("tilt", [-40, 0, 40])
def test_the_world_axis_nearest_to_up_in_the_image(up, tilt):
    to_camera = np.diag([1.0, -1.0, -1.0])  # y up to x right, y down, z away
    level = to_camera @ TO_Y_UP[up]
    pitch = rotation_about_axis(0, np.radians(np.float64(tilt)))
    tilted = pitch @ level
    assert nearest_axis_up(tilted) == up
    assert nearest_axis_up(np.stack([tilted, tilted])) == up


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
    z = complex(x, y)
    p = complex(p2, p1)
    r2 = abs(z) ** 2
    numerator = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
    denominator = 1 + k4 * r2 + k5 * r2**2 + k6 * r2**3
    radial = z * numerator / denominator
    tangential = p * r2 + 2 * z * (z * p.conjugate()).real
    moved = radial + tangential
    return moved.real, moved.imag


@pytest.fixture(params=LENSES)
def lens(request):
    """The coefficients of a lens as OpenCV has them."""
    return LENSES[request.param]


@pytest.fixture
def points(rng, lens):
    """Points that the lens sees."""
    reach = 0.03 if lens == LENSES["telephoto"] else 0.7
    return rng.uniform(-reach, reach, (3, 2, 50))


def test_a_lens_moves_points_as_in_opencv(points, lens):
    expected = [[opencv(x, y, *lens) for x, y in image.T] for image in points]
    moved, *_ = distort(points, complete_coefficients(lens))
    assert_allclose(transpose(moved), expected, atol=1e-14)


def test_the_derivative_of_a_lens_is_that_of_its_points(points, lens):
    coefficients = complete_coefficients(lens)
    step = 1e-6 * np.abs(points).max()

    def slopes_along(axis):
        """Return d x and d y by one coordinate, by central differences."""
        move = np.zeros((2, 1))
        move[axis] = step
        after, *_ = distort(points + move, coefficients)
        before, *_ = distort(points - move, coefficients)
        return np.moveaxis((after - before) / (2 * step), -2, 0)

    _, across, along, skew = distort(points, coefficients)

    dx_dx, dy_dx = slopes_along(0)
    dx_dy, dy_dy = slopes_along(1)
    assert_allclose(across, dx_dx, rtol=1e-7, atol=1e-9)
    assert_allclose(along, dy_dy, rtol=1e-7, atol=1e-9)
    assert_allclose(skew, dx_dy, rtol=1e-7, atol=1e-9)
    assert_allclose(skew, dy_dx, rtol=1e-7, atol=1e-9)


def test_undistortion_undoes_a_lens(points, lens):
    coefficients = complete_coefficients(lens)
    moved, *_ = distort(points, coefficients)
    assert_allclose(undistort(moved, coefficients), points, atol=1e-12)


def test_where_the_lens_bends_back_there_is_no_point():
    """1 - 0.3 r^2 turns over at r = 1.054, where the lens reaches 0.7027."""
    turns_over_at = np.sqrt(1 / 0.9)
    lens = complete_coefficients([-0.3, 0, 0, 0])
    points = np.array([[0.70, 0.71, -5.0, np.nan], [0.0, 0.0, 0.0, 0.0]])

    found = undistort(points, lens)

    assert np.isfinite(found[:, 0]).all()
    assert found[0, 0] < turns_over_at
    assert np.isnan(found[:, 1:]).all()


@pytest.mark.parametrize("angle", np.linspace(0, np.pi, 9))
class TestReachOfALens:
    """r - 0.3 r^3 reaches 2 / 3 of where it turns over, in every direction."""

    LENS = complete_coefficients([-0.3, 0, 0, 0])
    REACH = 2 / 3 * np.sqrt(1 / 0.9)

    def at(self, radius, angle):
        return radius * np.array([[np.cos(angle)], [np.sin(angle)]])

    def test_what_is_seen_just_within_it_comes_from_one_point(self, angle):
        points = self.at((1 - 1e-6) * self.REACH, angle)
        found = undistort(points, self.LENS)
        moved, *_ = distort(found, self.LENS)
        assert_allclose(moved, points, atol=1e-9)
        assert np.linalg.norm(found) < np.sqrt(1 / 0.9)

    @pytest.mark.parametrize("beyond", [1e-6, 1e-3, 1.0])
    def test_what_is_seen_beyond_it_comes_from_none(self, angle, beyond):
        points = self.at((1 + beyond) * self.REACH, angle)
        assert np.isnan(undistort(points, self.LENS)).all()

    def test_what_a_lens_shows_once_it_turned_over_twice_comes_from_none(self, angle):
        """r - r^3 + r^5 / 4 falls between 0.63 and 1.41, and leaves 2 where it is."""
        lens = complete_coefficients([-1.0, 0.25, 0, 0])
        points = self.at(2.0, angle)
        moved, *_ = distort(points, lens)
        assert_allclose(moved, points, atol=1e-12)
        assert np.isnan(undistort(points, lens)).all()


@pytest.mark.parametrize("angle", np.linspace(0, np.pi, 9))
def test_points_that_are_seen_beyond_a_pole_of_the_lens_are_found(angle):
    """The denominator of this lens is 0 at r = 1.39; at 1.2 it shows 2.34."""
    lens = complete_coefficients([0.064, -0.023, 0, 0, 0.032, -0.107, 0.119, -0.17])
    radius = np.array([0.9, 1.1, 1.2])
    points = radius * np.array([[np.cos(angle)], [np.sin(angle)]])
    moved, *_ = distort(points, lens)
    assert np.linalg.norm(moved[:, -1]) > 2
    assert_allclose(undistort(moved, lens), points, rtol=1e-9, atol=1e-9)


def test_large_points_are_undistorted_to_their_own_precision():
    """The residual that counts as none grows with the points."""
    points = np.array([[1e4, -2e4, 3e3], [1e3, 7e3, -9e3]])
    lens = complete_coefficients([1e-10, 1e-20, 0, 0])
    moved, *_ = distort(points, lens)
    assert_allclose(undistort(moved, lens), points, rtol=1e-12)


def test_without_distortion_points_stay_to_the_last_bit(rng):
    points = rng.normal(size=(2, 2, 5))
    no_lens = complete_coefficients([0, 0, 0, 0, 0])
    assert_array_equal(undistort(points, no_lens), points)


def test_each_image_may_have_a_lens_of_its_own(rng):
    coefficients = np.array([LENSES["barrel"], [0.1, 0, 0, 0]])
    lenses = complete_coefficients(coefficients)
    points = rng.uniform(-0.5, 0.5, (2, 2, 9))

    moved, *_ = distort(points, lenses)

    alone = [
        distort(image, complete_coefficients(lens))[0]
        for image, lens in zip(points, coefficients, strict=True)
    ]
    assert_array_equal(moved, alone)
    assert_allclose(undistort(moved, lenses), points, atol=1e-12)


@pytest.mark.parametrize(("y_axis", "sign"), [("up", -1), ("down", 1), (None, 1)])
def test_z_is_the_cross_product_of_x_and_y(y_axis, sign):
    """With x to the right and y down it points away from the camera, else to it."""
    assert depth_sign(y_axis) == sign


def test_a_count_of_coefficients_that_opencv_has_not_is_refused():
    with pytest.raises(ValueError, match="3 coefficients"):
        complete_coefficients([0.1, 0.2, 0.3])


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_points_before_the_camera_are_seen_however_near(sign):
    depth = np.array([1e-3, 0.3, 50.0, 0.0, -2.0])
    x = np.full(5, 0.2)
    y = np.full(5, -0.1)
    points = np.stack([x, y, sign * depth])
    focal_length = np.full((1, 2), 800.0)
    centre = np.array([[320.0, 240.0]])
    camera = Camera(focal_length, centre, sign)

    (landmarks,) = project_pinhole(camera, points[None])

    before = depth[:3]
    assert_allclose(landmarks[:, :3], [320 + 160 / before, 240 - 80 / before])
    assert np.isnan(landmarks[:, 3:]).all()


@pytest.fixture
def seen(rng):
    """Cameras of four images that differ, and points before them."""
    focal = rng.uniform(500, 1500, (4, 2))
    centre = rng.uniform(200, 800, (4, 2))
    points = rng.standard_normal((4, 3, 6))
    points[:, 2] += 8
    return Camera(focal, centre, 1.0, focal_sd=0.1), points


def test_a_normalised_camera_sees_normalised_landmarks(seen):
    camera, points = seen
    landmarks = normalise(project_pinhole(camera, points))

    in_their_unit = camera.normalised_as(landmarks)

    assert_allclose(project_pinhole(in_their_unit, points), landmarks.points)
    assert in_their_unit.focal_sd == camera.focal_sd


def test_cameras_of_some_images_see_as_they_did(seen):
    camera, points = seen
    some = np.array([2, 0])
    expected = project_pinhole(camera, points)[some]
    assert_array_equal(project_pinhole(camera.take(some), points[some]), expected)


SIZE = np.array([1080.0, 1920.0])

FOCAL_LENGTHS = [
    (ASSUMED_FOCAL * 1920, True),
    ([ASSUMED_FOCAL * 1920] * 2, True),
    (ASSUMED_FOCAL * 1080, False),
    (ASSUMED_FOCAL * 1920 + 1, False),
    (1920.0, False),
    (np.empty((0, 2)), False),
]


@pytest.mark.parametrize(("focal", "is_assumed"), FOCAL_LENGTHS)
def test_a_focal_length_is_assumed_by_the_longer_side(focal, is_assumed):
    assert is_assumed_focal(focal, SIZE) == is_assumed
