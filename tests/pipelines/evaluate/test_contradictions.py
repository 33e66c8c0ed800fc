"""Results and truth that contradict each other: in hand, sides, sizes or frames."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from shapefit.geometry.rotations import rotation_about
from tests.columns import in_rows, put

from .conftest import N
from .measured import SHAPES, measured


def warnings_of_shapes(results, truth):
    return measured(results, truth, metrics=SHAPES).warnings


def test_a_mirrored_truth_is_named(results, truth):
    mirrored = truth.replaced(shapes=truth.shapes * [-1.0, 1.0, 1.0])
    mirrored.shapes[0, 2:] = np.nan
    (warning,) = warnings_of_shapes(results, mirrored)
    assert "fit the truth better when it is mirrored" in warning
    assert "left-handed" in warning


TWO_PARTNERS = [0, 2, 1, 3, 4]


FOUR_PARTNERS = [0, 2, 1, 4, 3]


SIDED = [
    (("head", "left", "right", "foot", "hand"), TWO_PARTNERS),
    (("head", "l_eye", "r_eye", "foot", "hand"), TWO_PARTNERS),
    (("head", "LEar", "REar", "lfoot", "rfoot"), FOUR_PARTNERS),
]
"""Names of landmarks, and those of the other side."""


@pytest.mark.parametrize(("names", "partners"), SIDED)
def test_names_of_sides_that_are_exchanged_are_named(results, truth, names, partners):
    """Before a mirrored truth, which would fit a little better, too."""
    exchanged = results.replaced(
        landmark_names=names, shapes=results.shapes[:, partners]
    )
    (warning,) = warnings_of_shapes(exchanged, truth.replaced(landmark_names=names))
    assert "better when left and right are exchanged" in warning


@pytest.mark.parametrize(("names", "partners"), SIDED)
def test_names_of_sides_that_are_right_are_not_named(results, truth, names, partners):
    named = results.replaced(landmark_names=names)
    assert warnings_of_shapes(named, truth.replaced(landmark_names=names)) == ()


@pytest.fixture
def sized(results):
    """Results that state metres, by their unit or by a column."""
    metres = np.full(N, 1.0)
    return [
        results.replaced(unit="m"),
        put(results, {"metres_per_unit": metres}),
    ]


@pytest.mark.parametrize(("factor", "told"), [(1000, "9"), (0.01, "1 / ")])
def test_sizes_that_contradict_the_unit_are_named(sized, truth, factor, told):
    scaled = truth.replaced(shapes=factor * truth.shapes)
    for results in sized:
        (warning,) = warnings_of_shapes(results, scaled)
        assert f"the truth is {told}" in warning
        assert "both state m" in warning


def test_sizes_that_agree_are_not_named(sized, truth):
    for results in sized:
        assert warnings_of_shapes(results, truth) == ()


@pytest.mark.parametrize("factor", [1, 1000, 0.01])
def test_results_in_pixels_may_have_any_size(results, truth, factor):
    scaled = truth.replaced(shapes=factor * truth.shapes)
    assert warnings_of_shapes(results, scaled) == ()


QUARTER_TURNS = rotation_about(np.array([1.0, 0, 0]), np.full(N, np.pi / 2))


def test_rotations_of_another_frame_are_not_measured(results, truth):
    """The shapes are as in the truth, and the rotations say that they are not."""
    turned = results.replaced(rotation=results.rotation @ QUARTER_TURNS)
    found = measured(turned, truth)
    assert ("rotation", "deg") not in found.errors
    assert "no rotation: off by 90 degrees" in found.warnings[0]


def test_rotations_that_are_wrong_with_their_shapes_are_measured(results, truth):
    wrong = results.replaced(
        rotation=QUARTER_TURNS @ results.rotation,
        shapes=in_rows(QUARTER_TURNS @ results.as_columns()),
    )
    found = measured(wrong, truth)
    assert_allclose(found.errors["rotation", "deg"], 90)
