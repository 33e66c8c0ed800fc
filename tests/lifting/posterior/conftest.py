"""Scenes whose posterior is known, and mixtures."""

import numpy as np
import pytest

from shapefit.dictionary.mixture import Mixture
from shapefit.geometry.rotations import random_rotations
from shapefit.lifting.posterior import posterior
from tests.lifting.posterior.dense import Observation
from tests.lifting.posterior.scenes import draw_component
from tests.points import transpose


@pytest.fixture
def draw_scene():
    """Draw a scene and its rotation: an image of a shape from one Gaussian."""

    def draw(
        seed: int,
        *,
        p: int = 7,
        noisy: bool = False,
        hidden: tuple[int, ...] = (),
        steep: float = 0.0,
    ):
        rng = np.random.default_rng(seed)
        mean, C = draw_component(rng, p)
        R = random_rotations(1, rng)[0]
        deviation = np.linalg.cholesky(C) @ rng.normal(size=3 * p)
        X = R @ (mean + deviation.reshape(3, p))
        T = rng.normal(size=(2, 1))
        w = 37 * (X[:2] + T) + rng.normal(size=(2, p))
        slopes = None
        if steep:
            slopes = steep * rng.normal(size=(2, p))
            w -= 37 * slopes * X[2]
        noise = np.zeros((p, 2, 2))
        if noisy:
            L = rng.normal(size=(p, 2, 2))
            noise = 3 * L @ transpose(L)
        residual_variance = np.full(p, 0.003)
        residual_variance[list(hidden)] = np.inf
        w[:, list(hidden)] = np.nan
        return Observation(w, residual_variance, noise, mean, C, slopes), R

    return draw


@pytest.fixture
def draw_mixture():
    """Draw a mixture of k Gaussians over shapes of p landmarks."""

    def draw(seed: int, *, k: int = 3, p: int = 7, size: float = 0.2) -> Mixture:
        rng = np.random.default_rng(seed)
        components = [draw_component(rng, p, size) for _ in range(k)]
        means = np.stack([mean for mean, _ in components])
        covariances = np.stack([C for _, C in components])
        weights = rng.uniform(0.5, 1.5, size=k)
        near_the_first = means[0] + 0.4 * (means - means[0])
        return Mixture(weights / weights.sum(), near_the_first, covariances)

    return draw


@pytest.fixture
def to_the_end(monkeypatch):
    """Climb until nothing more is gained, as far as numbers can tell."""
    monkeypatch.setattr(posterior, "MIN_LIKELIHOOD_GAIN", 1e-12)
