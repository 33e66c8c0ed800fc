"""The marginal likelihood of landmarks under a Gaussian over shapes and a known view.

w_j = s R_2 x_j + t + e_j,  x ~ N(mu, C),  t ~ N(0, TAU^2 I),  e_j ~ N(0, Q_j^-1):
the landmarks w are jointly Gaussian, so that shape, translation and evidence are linear algebra.
A gross landmark has nothing to do with the shape and falls anywhere: with the chance g it comes
from a uniform density u in place of the Gaussian about its projection. The share q_j of belief
that it is not gross multiplies its precision Q_j (variational inference, one fixed point a round).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

TAU = 10.0
"""Standard deviation of the translation of normalised landmarks: wide."""

GENERATORS = np.array(
    [
        [[0, 0, 0], [0, 0, -1], [0, 1, 0]],
        [[0, 0, 1], [0, 0, 0], [-1, 0, 0]],
        [[0, -1, 0], [1, 0, 0], [0, 0, 0]],
        [[1, 0, 0], [0, 1, 0], [0, 0, 1]],
    ],
    dtype=np.float64,
)
"""d/d theta_i of exp(theta_4) exp([theta_1..3]_x) at 0: three turns in the camera frame, log s."""


@dataclass(frozen=True)
class Gross:
    """A landmark is gross with the chance `chance`; then it falls with the density `density`.

    The density is per area of normalised landmarks; a chance of 0 believes every landmark.
    """

    chance: float = 0.0
    density: float = 0.05


@dataclass(frozen=True)
class Views:
    """N views of N Gaussians: rotation R (N, 3, 3), log scale (N,), belief q (N, p)."""

    rotation: Floats
    log_scale: Floats
    belief: Floats


@dataclass(frozen=True)
class Marginal:
    """What N views say.

    value (N,) the log marginal likelihood, with the belief its variational bound; gradient and
    curvature (N, 4), (N, 4, 4) of its negative over theta; shape (N, 3, p) and covariance
    (N, 3p, 3p) of y = s R x + t in the frame of the camera, given the view; belief (N, p), the
    next fixed point.
    """

    value: Floats
    gradient: Floats
    curvature: Floats
    shape: Floats
    covariance: Floats
    belief: Floats


def turn(covariance: Floats, rotation: Floats) -> Floats:
    """(R x I) C (R x I)^T of C (N, 3p, 3p) and R (N, 3, 3)."""
    n, m, _ = covariance.shape
    blocks = covariance.reshape(n, 3, m // 3, 3, m // 3)
    turned = np.einsum("nab,nbicj->naicj", rotation, blocks, optimize=True)
    turned = np.einsum("naicj,ndc->naidj", turned, rotation, optimize=True)
    found: Floats = turned.reshape(n, m, m)
    return found


def find_marginal(
    landmarks: Floats,
    precision: Floats,
    means: Floats,
    covariances: Floats,
    views: Views,
    gross: Gross,
) -> Marginal:
    """Evaluate N views: landmarks w (N, 2, p), precision Q (N, p, 2, 2), 0 where hidden.

    means mu (N, 3, p), covariances C (N, 3p, 3p).
    """
    n, _, p = landmarks.shape
    s, q = np.exp(views.log_scale), views.belief
    seen = precision[:, :, 0, 0] > 0
    # Q_j = F_j F_j^T, so that F_j^T e_j is white
    F = np.zeros_like(precision)
    F[seen] = np.linalg.cholesky(precision[seen])
    white = np.zeros((n, 2, p, 2, p))  # F^T, (2p, 2p), block diagonal
    index = np.arange(p)
    white[:, :, index, :, index] = np.moveaxis(np.sqrt(q)[..., None, None] * F, 1, 0).swapaxes(2, 3)
    white = white.reshape(n, 2 * p, 2 * p)
    # latents z = (R x, t), observed as w = A z + e with A = [s E, 1]
    E = np.concatenate([np.eye(2 * p), np.zeros((2 * p, p))], axis=1)
    ones = np.kron(np.eye(2), np.ones((p, 1)))
    A = np.concatenate([s[:, None, None] * E, np.broadcast_to(ones, (n, 2 * p, 2))], axis=2)
    m = (views.rotation @ means).reshape(n, -1)
    P = np.zeros((n, 3 * p + 2, 3 * p + 2))
    P[:, : 3 * p, : 3 * p] = turn(covariances, views.rotation)
    P[:, 3 * p :, 3 * p :] = TAU**2 * np.eye(2)
    G = white @ A
    S = np.eye(2 * p) + G @ P @ G.swapaxes(1, 2)
    r = np.einsum("nij,nj->ni", white, np.where(seen[:, None], landmarks, 0.0).reshape(n, -1))
    r = r - np.einsum("nij,nj->ni", G[:, :, : 3 * p], m)
    inverse = np.linalg.inv(S)
    K = P @ G.swapaxes(1, 2) @ inverse  # gain
    alpha = np.einsum("nij,nj->ni", inverse, r)
    z = np.concatenate([m, np.zeros((n, 2))], axis=1) + np.einsum("nij,nj->ni", K, r)
    posterior = P - K @ G @ P
    # y = s R x + t in the frame of the camera
    Y = np.zeros((n, 3 * p, 3 * p + 2))
    Y[:, :, : 3 * p] = s[:, None, None] * np.eye(3 * p)
    Y[:, : 2 * p, 3 * p :] = ones
    shape = np.einsum("nij,nj->ni", Y, z).reshape(n, 3, p)
    covariance = Y @ posterior @ Y.swapaxes(1, 2)
    # derivatives over theta: A_i = s E (G_i x I)
    D = np.stack([np.kron(g[:2], np.eye(p)) for g in GENERATORS])  # (4, 2p, 3p)
    D = np.einsum("n,nab,ibc->niac", s, white, D, optimize=True)
    J = np.einsum("niac,nc->nia", D, z[:, : 3 * p])
    gradient = np.einsum("nca,niac->ni", K[:, : 3 * p], D) - np.einsum("na,nia->ni", alpha, J)
    change = np.einsum("niac,ncd,nbd->niab", D, P[:, : 3 * p], G, optimize=True)
    change = change + change.swapaxes(2, 3)
    B = np.einsum("nab,nibc->niac", inverse, change, optimize=True)
    curvature = np.einsum("nia,nab,njb->nij", J, inverse, J, optimize=True)
    curvature += 0.5 * np.einsum("niab,njba->nij", B, B, optimize=True)
    # evidence and belief
    log_q = np.zeros((n, p))
    log_q[seen] = 0.5 * np.linalg.slogdet(precision[seen])[1] - np.log(2 * np.pi)
    value = -0.5 * (np.linalg.slogdet(S)[1] + np.einsum("ni,ni->n", r, alpha))
    left = (landmarks - shape[:, :2]).transpose(0, 2, 1)
    block = covariance.reshape(n, 3, p, 3, p)[:, :2, :, :2]
    spread = np.stack([block[:, :, j, :, j] for j in range(p)], axis=1)
    misfit = np.einsum("npa,npab,npb->np", left, precision, left)
    misfit = misfit + np.einsum("npab,npba->np", precision, spread)
    chance, density = max(gross.chance, 1e-300), gross.density
    odds = np.log1p(-gross.chance) + log_q - 0.5 * misfit - np.log(chance) - np.log(density)
    belief = 1 / (1 + np.exp(-np.clip(odds, -500, 500)))
    terms = q * (np.log1p(-gross.chance) + log_q) + (1 - q) * (np.log(chance) + np.log(density))
    with np.errstate(divide="ignore", invalid="ignore"):
        terms = terms - np.where(q > 0, q * np.log(q), 0) - np.where(q < 1, (1 - q) * np.log1p(-q), 0)
    value = value + np.where(seen, terms, 0.0).sum(axis=1)
    return Marginal(value, gradient, curvature, shape, covariance, belief)
