"""log(1 + x) in vector instructions against NumPy's."""

import numpy as np

from shapefit import core


def logarithm(x):
    found = np.empty_like(x)
    core.parts.log_of_one_plus(x, found)
    return found


def test_it_is_exact_to_a_few_roundings():
    x = np.concatenate(
        [10.0 ** np.linspace(-300, 300, 5001), np.linspace(0, 3, 30_001), [0.41, 1.0]]
    )
    np.testing.assert_allclose(logarithm(x), np.log1p(x), rtol=1e-15)


def test_it_rises_and_keeps_nan():
    x = np.sort(np.concatenate([np.linspace(0, 5, 10_001), 2.0 ** np.arange(-60, 60)]))
    assert (np.diff(logarithm(x)) >= 0).all()
    assert np.isnan(logarithm(np.array([np.nan, 1.0]))).tolist() == [True, False]
