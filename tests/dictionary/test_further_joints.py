"""Feet and hands that only some bodies have: what they add, and what they leave as it was."""

import numpy as np
import pytest

from shapefit.dictionary.mixture import Mixture
from tools.further_joints import extend_prior


@pytest.fixture
def prior(rng):
    """Two components over four landmarks."""
    roots = rng.standard_normal((2, 12, 12)) / 4
    C = roots @ roots.swapaxes(1, 2) + 0.05 * np.eye(12)
    return Mixture(np.array([0.4, 0.6]), rng.standard_normal((2, 3, 4)), C)


def test_the_prior_of_the_known_landmarks_stays_to_the_last_bit(prior, rng):
    shapes = rng.standard_normal((200, 3, 6))
    found = extend_prior(prior, shapes, shrinkage=0.3, floor=0.01)
    known = found.marginal(np.arange(4))
    np.testing.assert_array_equal(known.means, prior.means)
    np.testing.assert_array_equal(known.covariances, prior.covariances)
    assert (np.linalg.eigvalsh(found.covariances) > 0).all()


def test_a_landmark_that_follows_from_others_is_found(prior, rng):
    """y = x_0 + 0.5 (x_1 - x_2) in all shapes, which the prior drew."""
    L = np.linalg.cholesky(prior.covariances)
    component = rng.choice(2, size=4000, p=prior.weights)
    drawn = prior.means.reshape(2, 12)[component] + np.einsum(
        "nij,nj->ni", L[component], rng.standard_normal((4000, 12))
    )
    x = drawn.reshape(-1, 3, 4)
    y = x[..., :1] + 0.5 * (x[..., 1:2] - x[..., 2:3])
    found = extend_prior(prior, np.concatenate([x, y], axis=2), shrinkage=0.0, floor=1e-6)
    rows = np.hstack([np.eye(4), np.zeros((4, 1))]).T
    rows[4] = [1, 0.5, -0.5, 0]
    every = np.kron(np.eye(3), rows)
    np.testing.assert_allclose(found.means, prior.means @ rows.T, atol=1e-3)
    expected = every @ prior.covariances @ every.T
    np.testing.assert_allclose(found.covariances, expected, atol=1e-3)
