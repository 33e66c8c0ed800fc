"""The error that is expected is that of draws, after the best similarity onto the truth."""

import numpy as np
import pytest

from shapefit.evaluation.metrics import similarity
from shapefit.lifting.trust import CALIBRATED, expected_error


@pytest.mark.parametrize("kind", ["of all coordinates", "of depths", "a similarity"])
def test_the_expected_error_is_that_of_draws(rng, kind):
    p, draws = 12, 300
    shape = rng.standard_normal((3, p))
    L = 0.05 * rng.standard_normal((3 * p, 3 * p)) / 3
    if kind == "of depths":
        L[: 2 * p] = 0.0
    if kind == "a similarity":
        x, y, z = shape - shape.mean(axis=1, keepdims=True)
        o = np.zeros(p)
        L = 0.02 * np.array([np.r_[o + 1, o, o], np.r_[-y, x, o], np.r_[x, y, z]]).T
    truths = shape + (L @ rng.standard_normal((L.shape[1], draws))).T.reshape(draws, 3, p)
    found = expected_error(shape[None], (L @ L.T)[None])[0] / CALIBRATED
    measured = similarity(np.repeat(shape[None], draws, axis=0), truths).mean()
    assert found == pytest.approx(measured, rel=0.08, abs=2e-3)


def test_what_is_not_finite_has_no_expected_error():
    shapes, covariance = np.ones((2, 3, 4)), np.tile(np.eye(12), (2, 1, 1))
    shapes[0, 0, 0], covariance[1, 0, 0] = np.nan, np.nan
    assert np.isnan(expected_error(shapes, covariance)).all()
