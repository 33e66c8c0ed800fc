"""The posterior under one Gaussian in plain NumPy, without a shortcut: the judge of the kernel."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Floats
from shapefit.dictionary.mixture import Mixture
from shapefit.geometry.rotations import random_rotations, rotation_about
from shapefit.lifting.posterior.posterior import Modes, Posterior, find_posterior

TAU_SQUARE = 900.0


@dataclass(frozen=True)
class Scene:
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
    scene: Scene, R: Floats, s: float, inlier_probability: Floats
) -> tuple[Floats, Floats, Floats]:
    """Mean (2m,) of the seen landmarks, their covariance, and that with s (R x + t) (3p, 2m)."""
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


def middle(scene: Scene) -> Floats:
    """Middle (2,) of the seen landmarks, where the wide prior on the translation is centred."""
    return scene.landmarks[:, scene.visible].mean(axis=1)


def observed(scene: Scene) -> Floats:
    return (scene.landmarks[:, scene.visible].T - middle(scene)).ravel()


def log_likelihood(
    scene: Scene, R: Floats, s: float, outliers: tuple[float, float], inlier_probability: Floats
) -> float:
    """The variational bound at the belief (p,); that of no outliers where gross[0] = 0.

    A translation with the deviation of TAU in the unit of shapes has the density of one that is
    flat in the unit of the landmarks but for a factor: s^2 of it is taken back.
    """
    mean, S, _ = joint(scene, R, s, inlier_probability)
    r = observed(scene) - mean
    value = -0.5 * (r @ np.linalg.solve(S, r) + np.linalg.slogdet(2 * np.pi * S)[1])
    value += 2 * np.log(s)
    chance, density = outliers
    if chance > 0:
        for j in scene.visible:
            q = inlier_probability[j]
            N = 2 * np.pi * (s * s * scene.residual_variance[j] * np.eye(2) + scene.noise[j])
            value += 0.5 * np.linalg.slogdet(N / q)[1] - 0.5 * q * np.linalg.slogdet(N)[1]
            value += q * np.log1p(-chance) + (1 - q) * np.log(chance * density)
            value -= q * np.log(q) + (0 if q == 1 else (1 - q) * np.log1p(-q))
    return float(value)


def condition(
    scene: Scene, R: Floats, s: float, inlier_probability: Floats
) -> tuple[Floats, Floats]:
    """Mean (3p,) and covariance of y = s (R x + t) given the view, the mean depth taken out."""
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
    turn = rotation_about(theta[:3] / angle, np.array(angle)) if angle > 0 else np.eye(3)
    return turn @ R, s * float(np.exp(theta[3]))


def derivative(function, R: Floats, s: float, step: float = 1e-5) -> Floats:  # type: ignore[no-untyped-def]
    """Central differences of function(R, s) over theta, along the first axis."""
    rows = []
    for i in range(4):
        theta = np.zeros(4)
        theta[i] = step
        rows.append((function(*moved(R, s, theta)) - function(*moved(R, s, -theta))) / (2 * step))
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
    """Shapes of the mixture, seen: y (n, 3, p) in the camera frame, landmarks, rotations."""
    rng = np.random.default_rng(seed)
    p = prior.means.shape[2]
    k = rng.choice(len(prior), size=n, p=prior.weights)
    noise = np.linalg.cholesky(prior.covariances)[k] @ rng.normal(size=(n, 3 * p, 1))
    R = random_rotations(n, rng)
    y = R @ (prior.means[k] + noise.reshape(n, 3, p))
    return y, y[:, :2] + np.sqrt(residual_variance) * rng.normal(size=(n, 2, p)), R


def shares_of(modes: Modes) -> Floats:
    """Each mode's share of the posterior (n, M): they add up to 1 in an image that has one."""
    share = np.exp(modes.log_evidence - modes.log_evidence[:, :1])
    return np.nan_to_num(share / share.sum(axis=1, keepdims=True))


def solve(
    prior: Mixture, w: Floats, starts: Floats, residual_variance: float, **options: Any
) -> Posterior:
    """Find the posterior of landmarks (n, 2, p); nan is hidden."""
    n, _, p = w.shape
    v = np.where(np.isfinite(w).all(axis=1), residual_variance, np.inf)
    return find_posterior(w, v, np.zeros((n, p, 2, 2)), prior, starts, **options)
