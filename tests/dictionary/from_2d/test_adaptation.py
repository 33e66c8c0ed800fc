"""A mixture adapted to planted images comes nearer to the truth; a start of all weight stays."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from shapefit.dictionary.from_2d.adaptation import (
    Adapted,
    Hypotheses,
    Responsibilities,
    Start,
    adapt,
    maximisation_step,
    mixture_of,
)
from shapefit.dictionary.from_2d.learning import SCALE
from shapefit.dictionary.from_2d.model import Images, Views, maximise
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


@pytest.fixture
def step(rng):
    """A maximisation step after made-up responsibilities: two components, three modes."""
    n, r, q = 5, 9, 3
    half = rng.standard_normal((r, q, q))
    hypotheses = Hypotheses(
        image=rng.integers(n, size=r),
        component=np.arange(r) % 2,
        views=Views(np.tile(np.eye(3), (r, 1, 1)), 0.1 * rng.standard_normal(r)),
        damping=np.ones(r),
    )
    made = SimpleNamespace(
        images=Images(np.zeros((n, 2, 4)), np.ones((n, 4)), np.zeros(n, np.intp)),
        found=Responsibilities(
            hypotheses,
            log_density=rng.standard_normal(n),
            share=rng.random(r),
            mean=rng.standard_normal((r, q)),
            covariance=half @ half.swapaxes(1, 2),
        ),
        state=Adapted(
            weights=np.array([0.3, 0.7]),
            shift=rng.standard_normal((2, q)),
            factor=np.linalg.cholesky(np.eye(q) + half[:2] @ half[:2].swapaxes(1, 2)),
            log_size=np.zeros(1),
            spread=0.02,
        ),
        start=Start(
            prior=Mixture(
                np.array([0.4, 0.6]), np.zeros((2, 3, 4)), np.tile(np.eye(12), (2, 1, 1))
            ),
            landmark_map=np.eye(4),
            noise=0.01,
            weight=6.0,
        ),
    )
    made.after = maximisation_step(made.images, made.found, made.state, made.start)
    return made


def test_a_step_has_the_moments_of_the_images_and_the_start_together(step):
    found, before = step.found, step.state
    for k, share in enumerate(step.start.prior.weights):
        own = found.hypotheses.component == k
        r, L = found.share[own], before.factor[k]
        z = before.shift[k] + found.mean[own] @ L.T
        second = L @ found.covariance[own] @ L.T + z[:, :, None] * z[:, None]
        whole = step.start.weight * share + r.sum()  # of the start z ~ N(0, I)
        mean = (r @ z) / whole
        moment = (np.tensordot(r, second, 1) + step.start.weight * share * np.eye(3)) / whole
        np.testing.assert_allclose(step.after.shift[k], mean)
        covariance = step.after.factor[k] @ step.after.factor[k].T
        np.testing.assert_allclose(covariance, moment - np.outer(mean, mean), atol=1e-12)


def test_the_objective_holds_the_expected_density_of_the_start(step):
    state, n, q = step.state, 5, 3
    corners = np.sqrt(q) * np.concatenate([np.eye(q), -np.eye(q)])  # moments of N(0, I)
    of_start = 0.0
    for k, share in enumerate(step.start.prior.weights):
        L = state.factor[k]
        z = np.linalg.solve(L, (corners - state.shift[k]).T)
        log_density = -0.5 * (z**2).sum(axis=0) - np.log(np.diag(L)).sum()
        of_start += share * (np.log(state.weights[k]) + log_density.mean())
    of_scale = -0.5 * n * (np.log(state.spread) + SCALE**2 / state.spread)
    expected = step.found.log_density.sum() + step.start.weight * of_start + of_scale
    assert step.after.objective == pytest.approx(expected)


def test_covariances_of_part_of_a_body_stay_positive(rng):
    """Modes are about the middle of the landmarks, which moves with those that are left out.

    What moves along the modes is multiplied, and shapes that are drawn go with it.
    """
    root = rng.normal(size=(18, 18))
    whole = (root @ root.T).reshape(3, 6, 3, 6)
    start = Mixture(
        np.ones(1), rng.normal(size=(1, 3, 5)), whole[:, :5][:, :, :, :5].reshape(1, 15, 15)
    )
    model = maximise(start.means[0], start.covariances[0], left=0)
    q = model.modes.shape[2]
    still = Adapted(np.ones(1), np.zeros((1, q)), np.eye(q)[None], np.zeros(1), 1.0)
    np.testing.assert_allclose(
        mixture_of(still, [model], start).covariances, start.covariances, atol=1e-9
    )
    less = replace(still, factor=0.1 * np.eye(q)[None])
    found = mixture_of(less, [model], start).covariances[0]
    assert np.linalg.eigvalsh(found).min() > 0
    drawn = np.linalg.cholesky(start.covariances[0]) @ rng.normal(size=(15, 4000))
    centred = drawn.reshape(3, 5, -1) - drawn.reshape(3, 5, -1).mean(axis=1, keepdims=True)
    moved = drawn - 0.9 * centred.reshape(15, -1)
    np.testing.assert_allclose(found, np.cov(moved), atol=0.1 * np.abs(found).max())
