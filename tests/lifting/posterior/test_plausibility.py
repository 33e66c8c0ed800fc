"""The p-value of an image: uniform where the model holds, 0 where nothing is believed."""

import numpy as np
from scipy.stats import chi2, kstest

from shapefit.lifting.posterior.plausibility import find_plausibility


def test_surprises_of_the_model_give_uniform_values(rng):
    seen = rng.integers(4, 20, 4000)
    surprise = chi2.rvs(2 * seen - 6, random_state=rng)
    p = find_plausibility(surprise, seen, seen.astype(float))
    assert kstest(p, "uniform").pvalue > 1e-3


def test_any_three_landmarks_fit():
    assert np.isnan(find_plausibility(np.array([7.0]), np.array([3]), np.array([3.0])))


def test_an_image_whose_landmarks_are_all_gross_is_not_plausible():
    p = find_plausibility(np.array([1.0, 1.0]), np.array([12, 12]), np.array([2.9, 3.1]))
    assert p[0] == 0.0
    assert p[1] > 0.9


def test_no_posterior_has_no_plausibility():
    assert np.isnan(find_plausibility(np.array([np.nan]), np.array([12]), np.array([0.0]))).all()
