"""Shapes of a mixture before pinhole cameras."""

import numpy as np

from shapefit.convex.solver import solve_newton
from shapefit.geometry.pinhole import Camera, project
from shapefit.geometry.rotations import random_rotations
from shapefit.lifting.lift import Lifting, Program, lift
from shapefit.lifting.methods import PosteriorOptions, Settings
from shapefit.lifting.posterior.method import face, lift_to_posterior

RESIDUAL_VARIANCE, P = 0.003, 12


class Scene:
    """Shapes of a mixture before cameras, off the optical axis, with noise in their own unit."""

    def __init__(self, prior, n: int, distance: float, sign: float) -> None:
        rng = np.random.default_rng(1)
        k = rng.choice(len(prior), size=n, p=prior.weights)
        roots = np.linalg.cholesky(prior.covariances)[k]
        z = rng.normal(size=(n, 3 * P))
        x = prior.means[k] + np.einsum("nij,nj->ni", roots, z).reshape(n, 3, P)
        self.rotation = random_rotations(n, rng)
        self.shapes = self.rotation @ x
        self.translation = distance * rng.normal(size=(n, 3)) * [0.2, 0.15, 0.0]
        self.translation[:, 2] = sign * distance
        self.camera = Camera(
            np.tile([1000.0, 1100.0], (n, 1)), np.tile([640.0, 360.0], (n, 1)), sign
        )
        noisy = self.shapes + self.translation[..., None]
        noisy[:, :2] += np.sqrt(RESIDUAL_VARIANCE) * rng.normal(size=(n, 2, P))
        self.landmarks = project(self.camera, noisy)
        self.visible = np.ones((n, P), dtype=bool)

    def starts(self):
        """Rotations near the true ones, as seen along the rays to the middles."""
        towards = face(np.eye(3)[None, None], self.landmarks, self.visible, self.camera)
        return towards.swapaxes(2, 3) @ self.rotation[:, None]

    def lift(self, prior, weights, modes: int = 0) -> Lifting:
        """Lift the landmarks through the camera, from many views."""
        settings = Settings(
            solve=solve_newton,
            mean_shape=prior.means[0],
            needs={"prior": prior},
            posterior=PosteriorOptions(covariance=True),
        )
        return lift(
            self.landmarks,
            weights,
            prior.means,
            Program(lam=0.3),
            lambda problem: lift_to_posterior(problem, settings, modes),
            camera=self.camera,
        )
