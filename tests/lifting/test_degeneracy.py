import numpy as np
import pytest

from shapefit.lifting.degeneracy import FLAT, find_degenerate

TRIANGLE = np.array([[0.0, 1.0, 0.0, 0.3], [0.0, 0.0, 1.0, 0.2]])


@pytest.mark.parametrize(
    ("landmarks", "weights", "reason"),
    [
        (TRIANGLE, [0, 0, 0, 0], "all landmarks are hidden"),
        (TRIANGLE, [1, 1, 0, 0], "only 2 visible landmarks, 3 are needed"),
        (TRIANGLE, [0, 0, 0, 0.1], "only 1 visible landmarks, 3 are needed"),
        (np.full((2, 4), 7.3), [1, 1, 1, 1], "all visible landmarks are at one point"),
        (np.zeros((2, 4)), [1, 1, 1, 1], "all visible landmarks are at one point"),
        ([[0, 1, 2, 9], [1, 3, 5, 0]], [1, 1, 1, 0], "all visible landmarks lie on one line"),
    ],
)
def test_a_degenerate_image_is_found_with_its_reason(landmarks, weights, reason):
    found = find_degenerate(
        np.array([TRIANGLE, landmarks], dtype=float), np.array([np.ones(4), weights], dtype=float)
    )
    assert found == {1: reason}


def test_how_thin_a_line_is_counts_beside_its_length():
    x = np.linspace(-1, 1, 20)
    across = (-1.0) ** np.arange(20)
    across -= x * (x @ across) / (x @ x)
    wide, long = np.linalg.norm(across), np.linalg.norm(x)
    thin = [np.stack([x, share * FLAT * long / wide * across]) for share in (0.7, 1.4)]
    found = find_degenerate(np.array(thin), np.ones((2, 20)))
    assert found == {0: "all visible landmarks lie on one line"}


def test_coordinates_that_cannot_be_squared_are_found():
    images = np.stack([1e200 * TRIANGLE, TRIANGLE, 1e-200 * TRIANGLE, 1e-318 * TRIANGLE])
    images = np.concatenate([images, [1.7e308 * (2 * TRIANGLE - 1)]])
    with np.errstate(all="raise", under="ignore"):
        found = find_degenerate(images, np.ones((5, 4)))
    assert list(found) == [0, 2, 3, 4]
    assert found[0] == "coordinates too large, up to 1e+200: use a larger unit"
    assert found[2].startswith("landmarks too close together, within 7e-201: use a smaller unit")
    assert "too close together" in found[3]
    assert "too large" in found[4]
