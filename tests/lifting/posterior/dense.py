"""The posterior of one image under one Gaussian in plain NumPy, as judge."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Floats
from shapefit.geometry.rotations import exponential

TAU_SQUARE = 900.0
"""Variance of the translation, in the unit of shapes."""


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

    @property
    def middle(self) -> Floats:
        """Middle (2,) of the seen landmarks, where the wide prior on the translation is
        centred.
        """
        return self.landmarks[:, self.visible].mean(axis=1)

    @property
    def observed(self) -> Floats:
        """The seen landmarks (2m,) about their middle, one after another."""
        return (self.landmarks[:, self.visible].T - self.middle).ravel()

    def noise_of(self, j: int, s: float) -> Floats:
        """Return the covariance (2, 2) of what landmark j adds to its shape of size
        s.
        """
        return s * s * self.residual_variance[j] * np.eye(2) + self.noise[j]


def shape_before_camera(scene: Observation, R: Floats) -> tuple[Floats, Floats]:
    """Mean (3p,) of R x and covariance (3p, 3p) of R x + t."""
    p = scene.landmarks.shape[1]
    turn = np.kron(R, np.eye(p))
    C = turn @ scene.covariance @ turn.T
    C[:p, :p] += TAU_SQUARE
    C[p : 2 * p, p : 2 * p] += TAU_SQUARE
    return turn @ scene.mean.ravel(), C


def projection(scene: Observation) -> Floats:
    """Return E (2m, 3p), from coordinates of a shape to those of its seen landmarks."""
    p = scene.landmarks.shape[1]
    E = np.zeros((2 * len(scene.visible), 3 * p))
    for row, j in enumerate(scene.visible):
        for a in range(2):
            E[2 * row + a, a * p + j] = 1
            if scene.slopes is not None:
                E[2 * row + a, 2 * p + j] = -scene.slopes[a, j]
    return E


def joint(
    scene: Observation, R: Floats, s: float, inlier_probability: Floats
) -> tuple[Floats, Floats, Floats]:
    """Mean (2m,) of the seen landmarks, their covariance, and that with s (R x + t)
    (3p, 2m).
    """
    mean, C = shape_before_camera(scene, R)
    E = projection(scene)
    N = np.zeros((len(E), len(E)))
    for row, j in enumerate(scene.visible):
        block = slice(2 * row, 2 * row + 2)
        N[block, block] = scene.noise_of(j, s) / inlier_probability[j]
    return s * E @ mean, s * s * E @ C @ E.T + N, s * s * C @ E.T


def log_normal(r: Floats, S: Floats) -> float:
    """Return the log density of a deviation r under the covariance S."""
    return -0.5 * (r @ np.linalg.solve(S, r) + log_det(2 * np.pi * S))


def log_det(S: Floats) -> float:
    return np.linalg.slogdet(S)[1]


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
    value = log_normal(scene.observed - mean, S) + 2 * np.log(s)
    chance, density = outliers
    if chance > 0:
        for j in scene.visible:
            q = inlier_probability[j]
            N = 2 * np.pi * scene.noise_of(j, s)
            value += 0.5 * log_det(N / q) - 0.5 * q * log_det(N)
            value += q * np.log1p(-chance) + (1 - q) * np.log(chance * density)
            value += entropy(q)
    return float(value)


def entropy(q: float) -> float:
    """Return the entropy of a choice with the probability q > 0."""
    if q == 1:
        return 0.0
    return -q * np.log(q) - (1 - q) * np.log1p(-q)


def condition(
    scene: Observation, R: Floats, s: float, inlier_probability: Floats
) -> tuple[Floats, Floats]:
    """Mean (3p,) and covariance of y = s (R x + t) given the view, the mean depth taken
    out.
    """
    p = scene.landmarks.shape[1]
    mean, S, cross = joint(scene, R, s, inlier_probability)
    before, C = shape_before_camera(scene, R)
    gain = cross @ np.linalg.inv(S)
    y = s * before + gain @ (scene.observed - mean)
    y[: 2 * p] += np.repeat(scene.middle, p)
    without_mean_depth = np.eye(3 * p)
    without_mean_depth[2 * p :, 2 * p :] -= 1 / p
    left = s * s * C - gain @ cross.T
    return without_mean_depth @ y, without_mean_depth @ left @ without_mean_depth.T


def moved(R: Floats, s: float, theta: Floats) -> tuple[Floats, float]:
    """R <- exp([theta_1..3]_x) R, s <- exp(theta_4) s."""
    turn = exponential(theta[:3])
    return turn @ R, s * float(np.exp(theta[3]))


OfView = Callable[[Floats, float], Floats | float]
"""A function of a rotation and a scale."""


def derivative(function: OfView, R: Floats, s: float, step: float = 1e-5) -> Floats:
    """Central differences of function(R, s) over theta, along the first axis."""
    rows = []
    for theta in step * np.eye(4):
        ahead = function(*moved(R, s, theta))
        behind = function(*moved(R, s, -theta))
        rows.append((ahead - behind) / (2 * step))
    return np.array(rows)


def hessian(function: OfView, R: Floats, s: float, step: float = 1e-3) -> Floats:
    """Second differences of function(R, s) over theta."""

    def at(theta: Floats) -> float:
        return float(function(*moved(R, s, theta)))

    H = np.empty((4, 4))
    steps = step * np.eye(4)
    for i, a in enumerate(steps):
        for j, b in enumerate(steps):
            difference = at(a + b) - at(a - b) - at(b - a) + at(-a - b)
            H[i, j] = difference / (4 * step * step)
    return H
