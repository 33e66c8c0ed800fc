"""Images whose shapes, rotations and coefficients are known."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest

from shapefit.convex.problem import Problem, build_problem
from shapefit.geometry.rotations import random_rotations
from tests.points import centred, mix, unit_norm, with_noise


@dataclass(frozen=True)
class Scene:
    """landmarks = Rbar sum_i c_i B_i + T 1^T + noise for n images."""

    landmarks: np.ndarray
    weights: np.ndarray
    atoms: np.ndarray
    mean_shape: np.ndarray
    coefficients: np.ndarray
    rotation: np.ndarray
    translation: np.ndarray

    @property
    def shapes(self) -> np.ndarray:
        return self.rotation @ mix(self.coefficients, self.atoms)

    def problem(self, lam: float) -> Problem:
        return build_problem(self.landmarks, self.atoms, lam, weights=self.weights)


@pytest.fixture
def make_scene(rng: np.random.Generator) -> Callable[..., Scene]:
    """Atoms are variations of one mean shape, as those of a dictionary are."""

    def make(
        n: int = 6,
        k: int = 8,
        p: int = 12,
        *,
        active: int = 3,
        noise: float = 0.0,
        hidden: float = 0.0,
        weighted: bool = False,
    ) -> Scene:
        mean = centred(rng.standard_normal((3, p)))
        variations = mean + 0.6 * rng.standard_normal((k, 3, p))
        atoms = unit_norm(centred(variations))
        coefficients = np.zeros((n, k))
        for image in range(n):
            used = rng.choice(k, active, replace=False)
            coefficients[image, used] = rng.uniform(1, 3, active)
        rotation = random_rotations(n, rng)
        translation = rng.standard_normal((n, 2))

        shapes = rotation @ mix(coefficients, atoms)
        landmarks = shapes[:, :2] + translation[..., None]
        landmarks = with_noise(landmarks, noise, rng)
        weights = np.ones((n, p))
        if weighted:
            weights = rng.uniform(0.3, 2, (n, p))
        weights *= rng.random((n, p)) >= hidden
        return Scene(
            landmarks, weights, atoms, mean, coefficients, rotation, translation
        )

    return make
