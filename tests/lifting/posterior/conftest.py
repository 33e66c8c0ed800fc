"""Scenes whose posterior is known."""

import numpy as np
import pytest

from shapefit.dictionary.mixture import Mixture
from shapefit.geometry.rotations import random_rotations
from shapefit.lifting.posterior import posterior
from tests.lifting.posterior.dense import Scene


def draw_component(rng: np.random.Generator, p: int, size: float = 0.2):
    """A centred mean (3, p) and a covariance (3p, 3p) about it."""
    mean = rng.normal(size=(3, p))
    mean -= mean.mean(axis=1, keepdims=True)
    B = size * rng.normal(size=(3 * p, 3 * p))
    return mean, B @ B.T / (3 * p) * 4 + 0.01 * np.eye(3 * p)


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
        x = mean.ravel() + np.linalg.cholesky(C) @ rng.normal(size=3 * p)
        X = R @ x.reshape(3, p)
        w = 37 * (X[:2] + rng.normal(size=(2, 1))) + rng.normal(size=(2, p))
        slopes = steep * rng.normal(size=(2, p)) if steep else None
        if slopes is not None:
            w -= 37 * slopes * X[2]
        residual_variance = np.full(p, 0.003)
        noise = np.zeros((p, 2, 2))
        if noisy:
            L = rng.normal(size=(p, 2, 2))
            noise = 3 * L @ L.swapaxes(1, 2)
        residual_variance[list(hidden)] = np.inf
        w[:, list(hidden)] = np.nan
        return Scene(w, residual_variance, noise, mean, C, slopes), R

    return draw


@pytest.fixture
def draw_mixture():
    """Draw a mixture of k Gaussians over shapes of p landmarks."""

    def draw(seed: int, *, k: int = 3, p: int = 7, size: float = 0.2) -> Mixture:
        rng = np.random.default_rng(seed)
        parts = [draw_component(rng, p, size) for _ in range(k)]
        weights = rng.uniform(0.5, 1.5, size=k)
        means = np.stack([parts[0][0] + 0.4 * (mean - parts[0][0]) for mean, _ in parts])
        return Mixture(weights / weights.sum(), means, np.stack([C for _, C in parts]))

    return draw


@pytest.fixture
def to_the_end(monkeypatch):
    """Climb until nothing more is gained, as far as numbers can tell."""
    monkeypatch.setattr(posterior, "TOLERANCE", 1e-12)
