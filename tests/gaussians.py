"""Gaussians over shapes: drawn from, and what a result stores of their covariances."""

import numpy as np

from shapefit.arrays import Floats
from shapefit.dictionary.mixture import Mixture
from tests.points import transpose

PAIRS = ((0, 1), (0, 2), (1, 2))
"""Coordinates whose correlations a result stores: xy, xz and yz."""


def single_gaussian(mean: Floats, covariance: Floats) -> Mixture:
    """Return the mixture of one Gaussian with a mean (3, p)."""
    return Mixture(np.ones(1), mean[None], covariance[None])


def covariance_of_root(root: Floats, floor: float = 0.0) -> Floats:
    """Return root root^T + floor I of roots (..., d, k)."""
    return root @ transpose(root) + floor * np.eye(root.shape[-2])


def draw_shapes(mixture: Mixture, n: int, rng: np.random.Generator) -> Floats:
    """Draw shapes (n, 3, p) of a mixture."""
    component = rng.choice(len(mixture), size=n, p=mixture.weights)
    means = mixture.means[component]
    root = np.linalg.cholesky(mixture.covariances)[component]
    noise = rng.normal(size=(n, root.shape[2]))
    deviations = np.einsum("nij,nj->ni", root, noise)
    return means + deviations.reshape(means.shape)


def deviations_and_correlations(covariance: Floats) -> tuple[Floats, Floats]:
    """Return deviations and correlations (n, 3, p) of covariances (n, p, 3, 3)."""
    sd = np.sqrt(np.einsum("npaa->nap", covariance))
    correlations = []
    for a, b in PAIRS:
        product = sd[:, a] * sd[:, b]
        correlations.append(covariance[..., a, b] / product)
    return sd, np.stack(correlations, axis=1)
