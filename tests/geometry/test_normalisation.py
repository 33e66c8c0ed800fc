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
    return rng.standard_normal((6, 3, 8)) * [[1.0], [2], [3]] + rng.standard_normal(
        (6, 3, 1)
    )


@pytest.fixture
def visible(rng):
    mask = rng.random((6, 8)) < 0.6
    mask[:, :3] = True
    return mask


def test_hand_computed():
    # x is 1, 3 (mean 2, deviation 1), y is -3, 3 (mean 0, deviation 3): the std is 2.
    corners = np.array([[1.0, 3], [-3, 3]])
    result = normalise(corners)
    assert_array_equal(result.centroid, [2, 0])
    assert result.scale == 2
    assert_array_equal(result.points, [[-0.5, 0.5], [-1.5, 1.5]])


def test_normalised_points_have_centroid_0_and_spread_1(points):
    normalised = normalise(points).points
    assert_allclose(centroid(normalised), 0, atol=1e-14)
    assert_allclose(std(normalised), 1, rtol=1e-14)


@pytest.mark.parametrize("garbage", [1e9, np.nan, np.inf])
def test_hidden_points_do_not_matter(points, visible, garbage):
    spoiled = np.where(visible[:, None], points, garbage)
    clean, result = normalise(points, visible), normalise(spoiled, visible)
    assert_array_equal(result.points, clean.points)
    assert_array_equal(result.scale, clean.scale)
    assert_array_equal(result.centroid, clean.centroid)


@pytest.mark.parametrize(
    ("unit", "metres"),
    [
        ("m", 1),
        ("dm", 0.1),
        (" Centimetres ", 0.01),
        ("MM", 1e-3),
        ("µm", 1e-6),
        ("in", 0.0254),
        ("feet", 0.3048),
        ("px", None),
    ],
)
def test_units_of_length(unit, metres):
    assert metres_in(unit) == metres
    assert as_metres(unit) == ((1, unit) if metres is None else (metres, "m"))


def test_points_too_far_apart_for_their_squares_are_infinitely_spread():
    points = np.array([[0.0, 1e300, 2.0], [0.0, 1.0, 5.0]])
    assert std(points) == np.inf
    assert std(points, np.array([True, False, True])) == pytest.approx(1.75)
