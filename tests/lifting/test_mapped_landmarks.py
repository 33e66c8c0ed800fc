"""Rows of weights of landmarks, and their error bars."""

import numpy as np

from shapefit.lifting.derived_landmarks import PAIRS, see_rows


def test_error_bars_of_rows_are_those_of_samples(rng):
    """Planted: points drawn with a covariance of all landmarks, seen through the rows."""
    n, p, q = 2, 5, 3
    rows = rng.standard_normal((q, p))
    root = rng.standard_normal((n, 3 * p, 3 * p))
    covariance = root @ root.swapaxes(1, 2)
    mean, apart = rng.standard_normal((n, 3, p)), np.array([0.0, 2.0, 0.0])
    found = see_rows(rows, mean, covariance, apart)
    draws = np.einsum("nij,nsj->nsi", root, rng.standard_normal((n, 40_000, 3 * p)))
    points = (mean[:, None] + draws.reshape(n, -1, 3, p)) @ rows.T
    points += apart * rng.standard_normal(points.shape)
    np.testing.assert_allclose(points.mean(axis=1), found.points, atol=0.2)
    np.testing.assert_allclose(points.std(axis=1), found.deviation, rtol=0.03)
    for row, (a, b) in enumerate(PAIRS):
        for image in range(n):
            for j in range(q):
                own = np.corrcoef(points[image, :, a, j], points[image, :, b, j])[0, 1]
                assert abs(own - found.correlation[image, row, j]) < 0.03


def test_landmarks_themselves_keep_their_error_bars(rng):
    root = rng.standard_normal((4, 12, 12))
    covariance = root @ root.swapaxes(1, 2)
    mean = rng.standard_normal((4, 3, 4))
    found = see_rows(np.eye(4), mean, covariance)
    np.testing.assert_array_equal(found.points, mean)
    variance = np.diagonal(covariance, axis1=1, axis2=2).reshape(4, 3, 4)
    np.testing.assert_allclose(found.deviation**2, variance)
    assert see_rows(np.eye(4), mean, None).deviation is None
