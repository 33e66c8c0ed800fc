import numpy as np
import pytest

from shapefit.geometry.rotations import random_rotations, rotation_about
from shapefit.meshes.views import View, level, upright

X, Y, Z = np.eye(3)


def test_walking_to_the_left_turns_the_front_to_the_right():
    np.testing.assert_allclose(View(90, 0).rotation() @ Z, X, atol=1e-15)
    np.testing.assert_allclose(View(90, 0).rotation() @ Y, Y, atol=1e-15)


def test_rising_shows_the_top():
    np.testing.assert_allclose(View(0, 90).rotation() @ Y, Z, atol=1e-15)
    # turned first: the tilt stays about the viewer's x
    np.testing.assert_allclose(View(90, 90).rotation() @ Y, Z, atol=1e-15)
    np.testing.assert_allclose(View(0, 0).rotation(), np.eye(3))


def test_upright_turns_images_with_y_down_by_half_a_turn(rng):
    points = rng.normal(size=(2, 3, 5))
    np.testing.assert_array_equal(upright(points, "up"), points)
    turned = upright(points, "down")
    half_turn = rotation_about(X, np.array([np.pi]))[0]
    np.testing.assert_allclose(turned, half_turn @ points, atol=1e-15)
    np.testing.assert_array_equal(upright(points[:, :2], "down"), turned[:, :2])


@pytest.mark.parametrize("up", [Y, [0.3, 0.9, -0.4], [1, 0, 0.2], [0, -1, 0], Z, -Z])
def test_level_is_a_rotation_that_sets_up_upright(up):
    up = np.asarray(up, dtype=float)
    rotation = level(up)
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-15)
    assert np.linalg.det(rotation) == pytest.approx(1)
    np.testing.assert_allclose(rotation @ up, Y * np.linalg.norm(up), atol=1e-15)


def test_level_takes_the_tilt_out_of_a_view_and_keeps_its_turn(rng):
    turn = View(37, 0).rotation()
    seen = View(37, 50).rotation()
    np.testing.assert_allclose(level(seen[:, 1]) @ seen, turn, atol=1e-15)


def test_level_keeps_what_faces_the_viewer():
    for rotation in random_rotations(5, np.random.default_rng(0)):
        facing = level(rotation[:, 1]) @ Z
        assert abs(facing[0]) < 1e-15
        assert facing[2] > 0


@pytest.mark.parametrize(("tilt", "facing"), [(90, -Y), (89, -Y), (-90, Y), (-89, Y)])
def test_level_gets_up_from_above_and_below_without_turning(tilt, facing):
    up = View(0, tilt).rotation()[:, 1]
    np.testing.assert_allclose(level(up) @ facing, Z, atol=0.02)
