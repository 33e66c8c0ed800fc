"""Normalisation: hand-computed units, its symmetries, and hidden points that do not
matter.
"""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from shapefit.geometry.normalisation import (
    as_metres,
    centroid,
    metres_in,
    normalise,
    std,
)


@pytest.fixture
def points(rng):
    """Shapes longer along one axis than along another, beside the origin."""
    shapes = rng.standard_normal((6, 3, 8)) * [[1.0], [2], [3]]
    return shapes + rng.standard_normal((6, 3, 1))


@pytest.fixture
def visible(rng):
    mask = rng.random((6, 8)) < 0.6
    mask[:, :3] = True
    return mask


def test_hand_computed():
    """x is 1, 3 (mean 2, deviation 1), y is -3, 3 (mean 0, deviation 3): the std is
    2.
    """
    corners = np.array([[1.0, 3], [-3, 3]])

    normalised = normalise(corners)

    assert_array_equal(normalised.centroid, [2, 0])
    assert normalised.scale == 2
    assert_array_equal(normalised.points, [[-0.5, 0.5], [-1.5, 1.5]])


def test_normalised_points_have_centroid_0_and_spread_1(points):
    normalised = normalise(points).points
    assert_allclose(centroid(normalised), 0, atol=1e-14)
    assert_allclose(std(normalised), 1, rtol=1e-14)


@pytest.mark.parametrize("garbage", [1e9, np.nan, np.inf])
def test_hidden_points_do_not_matter(points, visible, garbage):
    spoilt = np.where(visible[:, None], points, garbage)

    clean = normalise(points, visible)
    found = normalise(spoilt, visible)

    assert_array_equal(found.points, clean.points)
    assert_array_equal(found.scale, clean.scale)
    assert_array_equal(found.centroid, clean.centroid)


@pytest.mark.parametrize("hides", [False, True])
def test_an_image_is_normalised_whatever_stands_beside_it(points, visible, hides):
    points = points * np.arange(1, 7)[:, None, None]
    mask = visible if hides else None

    together = normalise(points, mask)

    for image, of_image in enumerate(points):
        alone = normalise(of_image, visible[image] if hides else None)
        assert_allclose(together.points[image], alone.points, atol=1e-14)
        assert_allclose(together.centroid[image], alone.centroid, atol=1e-14)
        assert together.scale[image] == pytest.approx(alone.scale, rel=1e-14)


LENGTHS = [
    ("m", 1),
    ("dm", 0.1),
    (" Centimetres ", 0.01),
    ("MM", 1e-3),
    ("µm", 1e-6),
    ("in", 0.0254),
    ("feet", 0.3048),
]


@pytest.mark.parametrize(("unit", "metres"), LENGTHS)
def test_units_of_length(unit, metres):
    assert metres_in(unit) == metres
    assert as_metres(unit) == (metres, "m")


def test_a_pixel_is_no_unit_of_length():
    assert metres_in("px") is None
    assert as_metres("px") == (1, "px")


FAR_APART = np.array([[0.0, 1e300, 2.0], [0.0, 1.0, 5.0]])
"""The square of the second point is no finite number."""


def test_points_too_far_apart_for_their_squares_are_infinitely_spread():
    assert std(FAR_APART) == np.inf


def test_a_hidden_point_far_apart_spreads_nothing():
    visible = np.array([True, False, True])
    assert std(FAR_APART, visible) == pytest.approx(1.75)
