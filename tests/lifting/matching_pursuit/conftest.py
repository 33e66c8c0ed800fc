"""Images of mixtures of a mean shape and few bases of either sign."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest

from shapefit.convex.problem import Problem, build_problem
from shapefit.geometry.normalisation import normalise
from shapefit.geometry.rotations import random_rotations
from shapefit.lifting.matching_pursuit import Pursuit, pursue

P = 12


@dataclass(frozen=True)
class Scene:
    """landmarks = R_bar s (mean + sum_i c_i B_i) + T 1^T + noise, with c_i of either sign."""

    landmarks: np.ndarray
    weights: np.ndarray
    mean: np.ndarray
    bases: np.ndarray
    shapes: np.ndarray
    edges: np.ndarray

    @property
    def problem(self) -> Problem:
        return build_problem(self.landmarks, self.bases, 1.0, weights=self.weights)

    def pursue(self, **keys) -> Pursuit:
        return pursue(self.problem, self.mean, self.edges, **keys)

    def mix(self, found: Pursuit) -> np.ndarray:
        mixed = np.einsum("nk,kap->nap", found.coefficients, self.bases)
        return found.mean_coefficient[:, None, None] * self.mean + mixed

    def squared_limbs(self, shapes: np.ndarray) -> np.ndarray:
        """Sum of the squared limb lengths of shapes (..., 3, p)."""
        start, end = self.edges.T
        return ((shapes[..., start] - shapes[..., end]) ** 2).sum(axis=(-2, -1))


@pytest.fixture
def make_scene(rng: np.random.Generator) -> Callable[..., Scene]:
    def make(n=5, k=9, *, active=3, noise=0.0, hidden=0.0, weighted=False) -> Scene:
        mean = normalise(rng.standard_normal((3, P))).points
        bases = rng.standard_normal((k, 3, P))
        bases -= bases.mean(axis=2, keepdims=True)
        bases /= np.linalg.norm(bases, axis=(1, 2), keepdims=True)
        coefficients = np.zeros((n, k))
        for image in range(n):
            coefficients[image, rng.choice(k, active, replace=False)] = rng.choice([-2, 2], active)
        shapes = mean + np.einsum("nk,kap->nap", coefficients, bases)
        shapes = rng.uniform(0.5, 2, (n, 1, 1)) * (random_rotations(n, rng) @ shapes)
        landmarks = shapes[:, :2] + rng.standard_normal((n, 2, 1))
        landmarks += noise * rng.standard_normal(landmarks.shape)
        weights = rng.uniform(0.3, 2, (n, P)) if weighted else np.ones((n, P))
        weights *= rng.random((n, P)) >= hidden
        edges = np.array([[(j - 1) // 2, j] for j in range(1, P)])  # a binary tree
        return Scene(landmarks, weights, mean, bases, shapes, edges)

    return make


@pytest.fixture
def noisy(make_scene) -> Scene:
    return make_scene(noise=0.3, hidden=0.2, weighted=True)
