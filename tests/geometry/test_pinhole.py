"""OpenCV's model of a lens, against an independent implementation and its own inverse."""

import numpy as np
import pytest

from shapefit.geometry.pinhole import Camera, complete, distort, project, undistort

LENSES = {
    "barrel": [-0.3, 0.1, 0.001, -0.002],
    "pincushion": [0.19, -0.28, -0.0024, 0.0028, 0.1475],
    "rational": [0.2, -0.1, 0.001, 0.002, 0.05, 0.1, 0.02, 0.001],
    "telephoto": [-58.19, 0.0, 0.0, 0.0, 0.0],
}


def opencv(x, y, k1, k2, p1, p2, k3=0.0, k4=0.0, k5=0.0, k6=0.0):
    """The formula of OpenCV's documentation of calib3d, point by point, in complex numbers.

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
    moved = distort(points, complete(lens))[0]
    known = [[opencv(x, y, *lens) for x, y in image.T] for image in points]
    np.testing.assert_allclose(moved.swapaxes(1, 2), known, atol=1e-14)
    np.testing.assert_allclose(undistort(moved, complete(lens)), points, atol=1e-12)


def test_where_the_lens_bends_back_there_is_no_point():
    """1 - 0.3 r^2 turns over at r = 1.054, where the lens reaches 0.7027."""
    points = np.array([[0.70, 0.71, -5.0, np.nan], [0.0, 0.0, 0.0, 0.0]])
    found = undistort(points, complete([-0.3, 0, 0, 0]))
    assert np.isfinite(found[:, 0]).all()
    assert found[0, 0] < np.sqrt(1 / 0.9)
    assert np.isnan(found[:, 1:]).all()


def test_zero_distortion_and_other_counts(rng):
    points = rng.normal(size=(2, 2, 5))
    np.testing.assert_array_equal(undistort(points, complete([0, 0, 0, 0, 0])), points)
    with pytest.raises(ValueError, match="3 coefficients"):
        complete([0.1, 0.2, 0.3])


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_points_before_the_camera_are_seen_however_near(sign):
    z = np.array([1e-3, 0.3, 50.0, 0.0, -2.0])
    points = np.stack([np.full(5, 0.2), np.full(5, -0.1), sign * z])[None]
    camera = Camera(np.full((1, 2), 800.0), np.array([[320.0, 240.0]]), sign)
    visible = project(camera, points)
    expected = np.array([320 + 160 / z[:3], 240 - 80 / z[:3]])
    np.testing.assert_allclose(visible[0, :, :3], expected)
    assert np.isnan(visible[0, :, 3:]).all()
