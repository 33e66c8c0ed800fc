"""Images of a mixture of Gaussians over shapes, from afar and before pinhole cameras;
their posterior, and what it must hold.
"""

from functools import partial
from typing import Any

import numpy as np
import pytest

from shapefit.arrays import Floats
from shapefit.convex.solver import solve_newton
from shapefit.dictionary.mixture import Mixture
from shapefit.geometry.pinhole import Camera, project_pinhole
from shapefit.geometry.rotations import random_rotations
from shapefit.lifting.lift import Lifting, Program, lift
from shapefit.lifting.posterior.method import lift_to_posterior, turn_towards_landmarks
from shapefit.lifting.posterior.model import PosteriorModel
from shapefit.lifting.posterior.posterior import Modes, Posterior, find_posterior
from tests.gaussians import covariance_of_root, draw_shapes
from tests.points import centred, transpose, with_noise


def draw_component(rng: np.random.Generator, p: int, size: float = 0.2):
    """A centred mean (3, p) and a covariance (3p, 3p) about it."""
    mean = centred(rng.normal(size=(3, p)))
    root = rng.normal(size=(3 * p, 3 * p)) * size * np.sqrt(4 / (3 * p))
    return mean, covariance_of_root(root, floor=0.01)


def draw_images(
    prior: Mixture, n: int, seed: int, residual_variance: float
) -> tuple[Floats, Floats, Floats]:
    """Shapes of the mixture, seen: y (n, 3, p) in the camera frame, landmarks,
    rotations.
    """
    rng = np.random.default_rng(seed)
    x = draw_shapes(prior, n, rng)
    R = random_rotations(n, rng)
    y = R @ x
    landmarks = with_noise(y[:, :2], np.sqrt(residual_variance), rng)
    return y, landmarks, R


def solve(
    prior: Mixture, w: Floats, starts: Floats, residual_variance: float, **options: Any
) -> Posterior:
    """Find the posterior of landmarks (n, 2, p); nan is hidden."""
    n, _, p = w.shape
    is_visible = np.isfinite(w).all(axis=1)
    v = np.where(is_visible, residual_variance, np.inf)
    no_noise = np.zeros((n, p, 2, 2))
    return find_posterior(w, v, no_noise, prior, starts, **options)


def shares_of(modes: Modes) -> Floats:
    """Each mode's share of the posterior (n, M): they add up to 1 in an image that has
    one.
    """
    share = np.exp(modes.log_evidence - modes.log_evidence[:, :1])
    return np.nan_to_num(share / share.sum(axis=1, keepdims=True))


CHI_SQUARED = {0.5: 2.366, 0.9: 6.251}
"""Share -> its quantile of chi^2 with 3 degrees."""


def assert_regions_hold(found: Posterior, truth: Floats) -> None:
    """Regions of 50 and 90% hold as many of the true points (n, 3, p)."""
    n, _, p = truth.shape
    error = transpose(truth - found.mean)
    blocks = found.covariance.reshape(n, 3, p, 3, p)
    C = np.stack([blocks[:, :, j, :, j] for j in range(p)], axis=1)
    whitened = np.linalg.solve(C, error[..., None])[..., 0]
    square = (error * whitened).sum(axis=2)
    for share, quantile in CHI_SQUARED.items():
        held = (square < quantile).mean(axis=1)  # landmarks of one image go together
        standard_error = held.std() / np.sqrt(n)
        assert held.mean() == pytest.approx(share, abs=4 * standard_error + 0.02)


RESIDUAL_VARIANCE = 0.003

P = 12
"""Landmarks of a filmed scene."""

FORWARD = np.eye(3)[None, None]
"""A start that is turned onto a ray is the turn from the optical axis to it."""


class FilmedScene:
    """Shapes of a mixture before cameras, off the optical axis, with noise in their own
    unit.
    """

    def __init__(self, prior: Mixture, n: int, distance: float, sign: float) -> None:
        rng = np.random.default_rng(1)
        x = draw_shapes(prior, n, rng)
        self.rotation = random_rotations(n, rng)
        self.shapes = self.rotation @ x
        self.translation = distance * rng.normal(size=(n, 3)) * [0.2, 0.15, 0.0]
        self.translation[:, 2] = sign * distance
        focal = np.tile([1000.0, 1100.0], (n, 1))
        centre = np.tile([640.0, 360.0], (n, 1))
        self.camera = Camera(focal, centre, sign)
        noisy = self.shapes + self.translation[..., None]
        noisy[:, :2] = with_noise(noisy[:, :2], np.sqrt(RESIDUAL_VARIANCE), rng)
        self.landmarks = project_pinhole(self.camera, noisy)
        self.visible = np.ones((n, P), dtype=bool)

    def towards(self, rotations: Floats) -> Floats:
        """Turn rotations (n, s, 3, 3) from the optical axis onto the rays to the
        middles of the landmarks.
        """
        return turn_towards_landmarks(
            rotations, self.landmarks, self.visible, self.camera
        )

    def starts(self) -> Floats:
        """Rotations near the true ones, as seen along the rays to the middles."""
        return transpose(self.towards(FORWARD)) @ self.rotation[:, None]

    def lift(self, prior: Mixture, weights: Floats, modes: int = 0) -> Lifting:
        """Lift the landmarks through the camera, from many views."""
        model = PosteriorModel(prior=prior, mean_shape=prior.means[0], covariance=True)
        method = partial(
            lift_to_posterior, model=model, solve=solve_newton, modes=modes
        )
        return lift(
            self.landmarks,
            weights,
            prior.means,
            Program(lam=0.3),
            method,
            camera=self.camera,
        )
