from __future__ import annotations

import numpy as np
import pytest

from shapefit.lifting.degeneracy import find_degenerate

TRIANGLE = np.array([[0.0, 1.0, 0.0, 0.3], [0.0, 0.0, 1.0, 0.2]])


@pytest.mark.parametrize(
    ("landmarks", "weights", "reason"),
    [
        (TRIANGLE, [0, 0, 0, 0], "all landmarks are hidden"),
        (TRIANGLE, [1, 1, 0, 0], "only 2 visible landmarks, 3 are needed"),
        (TRIANGLE, [0, 0, 0, 0.1], "only 1 visible landmarks, 3 are needed"),
        (np.full((2, 4), 7.3), [1, 1, 1, 1], "all visible landmarks lie on one point"),
        (np.zeros((2, 4)), [1, 1, 1, 1], "all visible landmarks lie on one point"),
        ([[0, 1, 2, 9], [1, 3, 5, 0]], [1, 1, 1, 0], "all visible landmarks lie on one line"),
    ],
)
def test_a_degenerate_image_is_found_with_its_reason(landmarks, weights, reason):
    found = find_degenerate(
        np.array([TRIANGLE, landmarks], dtype=float), np.array([np.ones(4), weights], dtype=float)
    )
    assert found == {1: reason}


def test_three_landmarks_off_a_line_are_enough():
    assert find_degenerate(TRIANGLE[None], np.array([[1.0, 1.0, 1.0, 0.0]])) == {}


@pytest.mark.parametrize("scale", [1e-12, 1.0, 1e12])
@pytest.mark.parametrize("shift", [0.0, 1.0])
def test_units_do_not_matter(scale, shift):
    line = np.array([[0.0, 1.0, 2.0, 3.0], [1.0, 3.0, 5.0, 7.0]])
    images = scale * (np.stack([TRIANGLE, line]) + shift)
    assert find_degenerate(images, np.ones((2, 4))) == {1: "all visible landmarks lie on one line"}


def test_a_thin_but_real_triangle_passes():
    thin = np.array([[0.0, 1.0, 2.0], [0.0, 1e-6, 0.0]])
    assert find_degenerate(thin[None], np.ones((1, 3))) == {}


def test_what_is_hidden_does_not_matter(rng):
    line = np.array([[0.0, 1.0, 2.0, 3.0], [1.0, 3.0, 5.0, np.nan]])
    line[:, 3] = rng.standard_normal(2)
    assert find_degenerate(line[None], np.array([[1.0, 1.0, 1.0, 0.0]])) != {}
