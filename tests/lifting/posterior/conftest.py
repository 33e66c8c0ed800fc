"""Scenes whose posterior is known, the posterior in plain NumPy as judge, and pinhole
cameras.
"""

from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from shapefit.arrays import Floats
from shapefit.convex.solver import solve_newton
from shapefit.dictionary.mixture import Mixture
from shapefit.geometry.pinhole import Camera, project_pinhole
from shapefit.geometry.rotations import random_rotations, rotation_about
from shapefit.lifting.lift import Lifting, Program, lift
from shapefit.lifting.posterior import posterior
from shapefit.lifting.posterior.method import lift_to_posterior, turn_towards_landmarks
from shapefit.lifting.posterior.model import PosteriorModel
from shapefit.lifting.posterior.posterior import Modes, Posterior, find_posterior


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
        return Observation(w, residual_variance, noise, mean, C, slopes), R

    return draw


@pytest.fixture
def draw_mixture():
    """Draw a mixture of k Gaussians over shapes of p landmarks."""

    def draw(seed: int, *, k: int = 3, p: int = 7, size: float = 0.2) -> Mixture:
        rng = np.random.default_rng(seed)
        parts = [draw_component(rng, p, size) for _ in range(k)]
        weights = rng.uniform(0.5, 1.5, size=k)
        means = np.stack(
            [parts[0][0] + 0.4 * (mean - parts[0][0]) for mean, _ in parts]
        )
        return Mixture(weights / weights.sum(), means, np.stack([C for _, C in parts]))

    return draw


@pytest.fixture
def to_the_end(monkeypatch):
    """Climb until nothing more is gained, as far as numbers can tell."""
    monkeypatch.setattr(posterior, "MIN_LIKELIHOOD_GAIN", 1e-12)


TAU_SQUARE = 900.0


@dataclass(frozen=True)
class Observation:
    """One image and one Gaussian; hidden landmarks have an infinite misfit."""

    landmarks: Floats  # (2, p)
    residual_variance: Floats  # (p,)
    noise: Floats  # (p, 2, 2)
    mean: Floats  # (3, p)
    covariance: Floats  # (3p, 3p)
    slopes: Floats | None = None  # (2, p) of the rays

    @property
    def visible(self) -> NDArray[np.intp]:
        return np.flatnonzero(np.isfinite(self.residual_variance))


def joint(
    scene: Observation, R: Floats, s: float, inlier_probability: Floats
) -> tuple[Floats, Floats, Floats]:
    """Mean (2m,) of the seen landmarks, their covariance, and that with s (R x + t)
    (3p, 2m).
    """
    p = scene.landmarks.shape[1]
    turn = np.kron(R, np.eye(p))
    C = turn @ scene.covariance @ turn.T
    C[:p, :p] += TAU_SQUARE
    C[p : 2 * p, p : 2 * p] += TAU_SQUARE
    E = np.zeros((2 * len(scene.visible), 3 * p))
    N = np.zeros((len(E), len(E)))
    for row, j in enumerate(scene.visible):
        for a in range(2):
            E[2 * row + a, a * p + j] = 1
            if scene.slopes is not None:
                E[2 * row + a, 2 * p + j] = -scene.slopes[a, j]
        block = slice(2 * row, 2 * row + 2)
        N[block, block] = (
            s * s * scene.residual_variance[j] * np.eye(2) + scene.noise[j]
        ) / inlier_probability[j]
    return s * E @ turn @ scene.mean.ravel(), s * s * E @ C @ E.T + N, s * s * C @ E.T


def middle(scene: Observation) -> Floats:
    """Middle (2,) of the seen landmarks, where the wide prior on the translation is
    centred.
    """
    return scene.landmarks[:, scene.visible].mean(axis=1)


def observed(scene: Observation) -> Floats:
    return (scene.landmarks[:, scene.visible].T - middle(scene)).ravel()


def log_likelihood(
    scene: Observation,
    R: Floats,
    s: float,
    outliers: tuple[float, float],
    inlier_probability: Floats,
) -> float:
    """The variational bound at inlier probabilities (p,); without outliers where
    outliers[0] = 0.

    A translation with the deviation of TAU in the unit of shapes has the density of one
    that is flat in the unit of the landmarks but for a factor: s^2 of it is taken back.
    """
    mean, S, _ = joint(scene, R, s, inlier_probability)
    r = observed(scene) - mean
    value = -0.5 * (r @ np.linalg.solve(S, r) + np.linalg.slogdet(2 * np.pi * S)[1])
    value += 2 * np.log(s)
    chance, density = outliers
    if chance > 0:
        for j in scene.visible:
            q = inlier_probability[j]
            N = (
                2
                * np.pi
                * (s * s * scene.residual_variance[j] * np.eye(2) + scene.noise[j])
            )
            value += (
                0.5 * np.linalg.slogdet(N / q)[1] - 0.5 * q * np.linalg.slogdet(N)[1]
            )
            value += q * np.log1p(-chance) + (1 - q) * np.log(chance * density)
            value -= q * np.log(q) + (0 if q == 1 else (1 - q) * np.log1p(-q))
    return float(value)


def condition(
    scene: Observation, R: Floats, s: float, inlier_probability: Floats
) -> tuple[Floats, Floats]:
    """Mean (3p,) and covariance of y = s (R x + t) given the view, the mean depth taken
    out.
    """
    p = scene.landmarks.shape[1]
    mean, S, cross = joint(scene, R, s, inlier_probability)
    turn = np.kron(R, np.eye(p))
    C = turn @ scene.covariance @ turn.T
    C[:p, :p] += TAU_SQUARE
    C[p : 2 * p, p : 2 * p] += TAU_SQUARE
    gain = cross @ np.linalg.inv(S)
    y = s * turn @ scene.mean.ravel() + gain @ (observed(scene) - mean)
    y[: 2 * p] += np.repeat(middle(scene), p)
    Z = np.eye(3 * p)
    Z[2 * p :, 2 * p :] -= 1 / p
    return Z @ y, Z @ (s * s * C - gain @ cross.T) @ Z.T


def moved(R: Floats, s: float, theta: Floats) -> tuple[Floats, float]:
    """R <- exp([theta_1..3]_x) R, s <- exp(theta_4) s."""
    angle = float(np.linalg.norm(theta[:3]))
    turn = (
        rotation_about(theta[:3] / angle, np.array(angle)) if angle > 0 else np.eye(3)
    )
    return turn @ R, s * float(np.exp(theta[3]))


def derivative(function, R: Floats, s: float, step: float = 1e-5) -> Floats:  # type: ignore[no-untyped-def]
    """Central differences of function(R, s) over theta, along the first axis."""
    rows = []
    for i in range(4):
        theta = np.zeros(4)
        theta[i] = step
        rows.append(
            (function(*moved(R, s, theta)) - function(*moved(R, s, -theta)))
            / (2 * step)
        )
    return np.array(rows)


def hessian(function, R: Floats, s: float, step: float = 1e-3) -> Floats:  # type: ignore[no-untyped-def]
    """Second differences of function(R, s) over theta."""
    H = np.empty((4, 4))
    eye = step * np.eye(4)
    for i in range(4):
        for j in range(4):
            H[i, j] = (
                function(*moved(R, s, eye[i] + eye[j]))
                - function(*moved(R, s, eye[i] - eye[j]))
                - function(*moved(R, s, eye[j] - eye[i]))
                + function(*moved(R, s, -eye[i] - eye[j]))
            ) / (4 * step * step)
    return H


def draw_images(
    prior: Mixture, n: int, seed: int, residual_variance: float
) -> tuple[Floats, Floats, Floats]:
    """Shapes of the mixture, seen: y (n, 3, p) in the camera frame, landmarks,
    rotations.
    """
    rng = np.random.default_rng(seed)
    p = prior.means.shape[2]
    k = rng.choice(len(prior), size=n, p=prior.weights)
    noise = np.linalg.cholesky(prior.covariances)[k] @ rng.normal(size=(n, 3 * p, 1))
    R = random_rotations(n, rng)
    y = R @ (prior.means[k] + noise.reshape(n, 3, p))
    return y, y[:, :2] + np.sqrt(residual_variance) * rng.normal(size=(n, 2, p)), R


def shares_of(modes: Modes) -> Floats:
    """Each mode's share of the posterior (n, M): they add up to 1 in an image that has
    one.
    """
    share = np.exp(modes.log_evidence - modes.log_evidence[:, :1])
    return np.nan_to_num(share / share.sum(axis=1, keepdims=True))


def solve(
    prior: Mixture, w: Floats, starts: Floats, residual_variance: float, **options: Any
) -> Posterior:
    """Find the posterior of landmarks (n, 2, p); nan is hidden."""
    n, _, p = w.shape
    v = np.where(np.isfinite(w).all(axis=1), residual_variance, np.inf)
    return find_posterior(w, v, np.zeros((n, p, 2, 2)), prior, starts, **options)


def assert_regions_hold(found: Posterior, truth: Floats) -> None:
    """Regions of 50 and 90% hold as many of the true points (n, 3, p)."""
    n, _, p = truth.shape
    apart = (truth - found.mean).transpose(0, 2, 1)
    blocks = found.covariance.reshape(n, 3, p, 3, p)
    C = np.stack([blocks[:, :, j, :, j] for j in range(p)], axis=1)
    square = np.einsum(
        "npa,npa->np", apart, np.linalg.solve(C, apart[..., None])[..., 0]
    )
    for share, bound in (
        (0.5, 2.366),
        (0.9, 6.251),
    ):  # quantiles of chi^2 with 3 degrees
        inside = (square < bound).mean(axis=1)  # landmarks of one image go together
        error = inside.std() / np.sqrt(n)
        assert inside.mean() == pytest.approx(share, abs=4 * error + 0.02)


RESIDUAL_VARIANCE, P = 0.003, 12


class Scene:
    """Shapes of a mixture before cameras, off the optical axis, with noise in their own
    unit.
    """

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
        self.landmarks = project_pinhole(self.camera, noisy)
        self.visible = np.ones((n, P), dtype=bool)

    def starts(self):
        """Rotations near the true ones, as seen along the rays to the middles."""
        towards = turn_towards_landmarks(
            np.eye(3)[None, None], self.landmarks, self.visible, self.camera
        )
        return towards.swapaxes(2, 3) @ self.rotation[:, None]

    def lift(self, prior, weights, modes: int = 0) -> Lifting:
        """Lift the landmarks through the camera, from many views."""
        model = PosteriorModel(prior=prior, mean_shape=prior.means[0], covariance=True)
        return lift(
            self.landmarks,
            weights,
            prior.means,
            Program(lam=0.3),
            partial(lift_to_posterior, model=model, solve=solve_newton, modes=modes),
            camera=self.camera,
        )
