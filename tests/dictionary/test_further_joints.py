"""Feet and hands that only some bodies have: what they add, and what they leave as it was."""

import numpy as np
import pytest

from shapefit.dictionary.mixture import Mixture
from shapefit.io.skeletons import FURTHER, PEOPLE
from tools.further_joints import BALL, BEHIND, BELOW, Regression, extend_prior, with_heels


@pytest.fixture
def prior(rng):
    """Two components over four landmarks."""
    roots = rng.standard_normal((2, 12, 12)) / 4
    C = roots @ roots.swapaxes(1, 2) + 0.05 * np.eye(12)
    return Mixture(np.array([0.4, 0.6]), rng.standard_normal((2, 3, 4)), C)


def test_a_regression_makes_the_covariance_that_it_was_taken_from(rng):
    root = rng.standard_normal((5, 7, 7))
    C = root @ root.swapaxes(1, 2)
    again = Regression.of(C, 4).joint(C[:, :4, :4])
    np.testing.assert_allclose(again, C, atol=1e-9)


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


def test_heels_lie_behind_and_below_the_ankles_of_a_man_who_stands(rng):
    names = [name for name in (*PEOPLE, *FURTHER) if not name.endswith("heel")]
    shapes = rng.standard_normal((1, 3, len(names)))
    for side in "rl":
        ankle = shapes[0, :, names.index(f"{side}ankle")]
        shapes[0, :, names.index(f"{side}knee")] = ankle + np.array([0, 0.25, 0])
        shapes[0, :, names.index(f"{side}ball")] = ankle + np.array([BALL[0], -BALL[1], 0])
    found = with_heels(shapes, names)[0]
    joints = (*PEOPLE, *FURTHER)
    for side in "rl":
        away = found[:, joints.index(f"{side}heel")] - found[:, joints.index(f"{side}ankle")]
        np.testing.assert_allclose(away, [-BEHIND, -BELOW, 0], atol=1e-12)
