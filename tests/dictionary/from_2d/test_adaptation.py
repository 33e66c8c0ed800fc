"""A mixture adapted to planted images comes nearer to the truth; a start of all weight stays."""

import numpy as np
import pytest

from shapefit.dictionary.from_2d.adaptation import Start, adapt
from shapefit.dictionary.mixture import Mixture
from shapefit.geometry.normalisation import normalise
from shapefit.geometry.procrustes import similarity_transform


@pytest.fixture
def planted(plant, rng):
    """Images of a class, and a start from which it has moved: a component near it, one far off."""
    made = plant(80, p=8, modes=2, noise=0.02)
    truth, scale = made.model.mean, normalise(made.model.mean).scale
    off = 0.2 * rng.standard_normal((2, *truth.shape))
    off -= off.mean(axis=2, keepdims=True)
    V = made.model.modes.reshape(truth.size, -1)
    C = (V @ V.T + 0.04 * np.eye(truth.size)) / scale**2
    off[1] *= 3.0
    made.start = Mixture(np.array([0.8, 0.2]), (truth + off) / scale, np.stack([C, 1.2 * C]))
    made.truth = truth / scale
    return made


def adapted(made, weight, landmark_map=None):
    A = np.eye(8) if landmark_map is None else landmark_map
    start = Start(prior=made.start, landmark_map=A, noise=0.01, weight=weight)
    rounds = list(adapt(made.images, made.shapes, start))
    return rounds[-1][0], np.array([objective for _, objective in rounds])


def distance(mixture, truth):
    """Distance of the mean of the likelier component, turned onto the truth, from it."""
    mean = mixture.means[0]
    return np.linalg.norm(similarity_transform(mean, truth).apply(mean) - truth)


def test_adapted_means_are_nearer_to_the_truth_and_the_objective_never_falls(planted):
    found, objective = adapted(planted, 20.0)
    assert (np.diff(objective) > 0).all()
    assert distance(found, planted.truth) < 0.6 * distance(planted.start, planted.truth)
    np.testing.assert_allclose(found.weights.sum(), 1.0)
    assert (np.linalg.eigvalsh(found.covariances) > 0).all()


def test_a_start_that_weighs_without_end_is_returned(planted):
    found, _ = adapted(planted, 1e12)
    np.testing.assert_allclose(found.weights, planted.start.weights, atol=1e-8)
    np.testing.assert_allclose(found.means, planted.start.means, atol=1e-8)
    np.testing.assert_allclose(found.covariances, planted.start.covariances, atol=1e-8)


def test_landmarks_that_lie_apart_from_the_shapes_adapt_them_through_their_map(planted):
    A = np.eye(8)
    A[0, :2] = 0.7, 0.3
    shapes = planted.shapes @ A.T
    planted.images = type(planted.images)(
        shapes[:, :2], planted.images.weights, planted.images.sequence
    )
    planted.shapes = shapes
    found, objective = adapted(planted, 20.0, A)
    assert (np.diff(objective) > 0).all()
    assert distance(found, planted.truth) < 0.6 * distance(planted.start, planted.truth)
