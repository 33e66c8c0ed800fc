"""A prior over shapes: a mixture of Gaussians, learned by expectation maximisation.

max over pi, mu, C of  sum_n w_n log sum_k pi_k exp(E log N(x_n + e; mu_k, C_k))
                       - kappa / 2 sum_k (log |C_k| + tr(C_k^-1 G)),

e ~ N(0, variance_floor I). The expectation over e raises every covariance by
variance_floor I; kappa draws the covariances towards G, that of all shapes and e
together, as that many shapes would. No round lowers the objective.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from shapefit import core
from shapefit.arrays import Floats, Integers
from shapefit.threads import on_threads, thread_count

MAX_KMEANS_ROUNDS = 20
"""Of Lloyd's method, which finds the start."""

MIN_SHAPES = 1e-3
"""Shapes of a component below which it has died, and would only mislead."""


@dataclass(frozen=True, eq=False, repr=False)
class Mixture:
    """A mixture of Gaussians over shapes x: p(x) = sum_k pi_k N(x; mu_k, C_k).

    Shapes are flattened: all x, then all y, then all z. weights pi (K,), positive, with
    the sum 1; means mu (K, 3, p); covariances C (K, 3p, 3p).
    """

    weights: Floats
    means: Floats
    covariances: Floats

    def __len__(self) -> int:
        return len(self.weights)

    @property
    def by_landmark(self) -> Floats:
        """Return the covariances with an axis for landmarks: (K, p, 3, p, 3)."""
        k, _, p = self.means.shape
        return self.covariances.reshape(k, 3, p, 3, p).transpose(0, 2, 1, 4, 3)

    @cached_property
    def whitening(self) -> Floats:
        """Return W (K, 3p, 3p), lower triangular, with C^-1 = W^T W."""
        return np.tril(np.linalg.inv(np.linalg.cholesky(self.covariances)))

    @property
    def log_determinants(self) -> Floats:
        """Return log |C| (K,)."""
        diagonals = self.whitening.diagonal(axis1=1, axis2=2)
        log_determinants: Floats = -2 * np.log(diagonals).sum(axis=1)
        return log_determinants

    @classmethod
    def of_landmarks(
        cls, weights: Floats, means: Floats, by_landmark: Floats
    ) -> Mixture:
        """Make the mixture from covariances (K, p, 3, p, 3)."""
        k, _, p = means.shape
        C = by_landmark.transpose(0, 2, 1, 4, 3).reshape(k, 3 * p, 3 * p)
        return cls(weights, means, C)

    def marginal(self, landmarks: Integers) -> Mixture:
        """Return the marginal over the landmarks with these indices, in their order."""
        means = np.take(self.means, landmarks, axis=2)
        rows = np.take(self.by_landmark, landmarks, axis=1)
        C = np.take(rows, landmarks, axis=3)
        return self.of_landmarks(self.weights, means, C)

    def log_density(self, shapes: Floats) -> Floats:
        """Return log(pi_k N(x_n; mu_k, C_k)) (n, K) of shapes x (n, 3, p)."""
        K = len(self)
        x = np.ascontiguousarray(shapes.reshape(len(shapes), -1), np.float64)
        d = x.shape[1]
        log_peaks = -0.5 * (self.log_determinants + d * np.log(2 * np.pi))
        density = np.empty((len(x), K))
        core.find_log_densities(
            shapes=x,
            means=np.ascontiguousarray(self.means.reshape(K, d), np.float64),
            whiten=self.whitening,
            constants=np.log(self.weights) + log_peaks,
            log_densities=density,
            threads=thread_count(0),
        )
        return density


def widen(mixture: Mixture, factor: float) -> Mixture:
    """Return the mixture with its covariances multiplied by a factor."""
    return Mixture(mixture.weights, mixture.means, factor * mixture.covariances)


class LearnedMixture(NamedTuple):
    """The mixture and the objective after each round, never falling."""

    mixture: Mixture
    trace: Floats


def learn_mixture(
    shapes: Floats,
    components: int,
    *,
    shrinkage: float,
    variance_floor: float,
    max_rounds: int = 30,
    tolerance: float = 1e-4,
) -> LearnedMixture:
    """Learn a mixture of Gaussians from shapes (n, 3, p), see `mixture_rounds`."""
    *_, learned = mixture_rounds(
        shapes,
        components,
        shrinkage=shrinkage,
        variance_floor=variance_floor,
        max_rounds=max_rounds,
        tolerance=tolerance,
    )
    return learned


def mixture_rounds(
    shapes: Floats,
    components: int,
    *,
    shrinkage: float,
    variance_floor: float,
    max_rounds: int = 30,
    tolerance: float = 1e-4,
) -> Iterator[LearnedMixture]:
    """Learn a mixture of Gaussians from shapes (n, 3, p); yield it after each round.

    The shapes are normalised and aligned. There is at least one round.

    shrinkage in [0, 1): the share of G in the covariance of a component of average
    size; variance_floor > 0: variance of every coordinate beyond that of the shapes.
    The start is k-means with the seeds of k-means++ drawn from a fixed stream: equal
    shapes give equal mixtures. Ends where a round raises the objective by no more than
    `tolerance` a shape. Components that no shape belongs to any more are left out.
    Raises ValueError for more components than shapes.
    """
    X = np.ascontiguousarray(shapes.reshape(len(shapes), -1))
    n, d = X.shape
    if not 1 <= components <= n:
        raise ValueError(f"components must be within 1..{n}, is {components}")
    ones = np.ones(n)
    G = _scatter(X, ones, ones @ X / n) / n + variance_floor * np.eye(d)
    kappa = shrinkage / (1 - shrinkage) * n / components
    nearest = np.eye(components)[kmeans(X, components)]
    mixture = maximise(X, nearest, G, kappa, variance_floor)
    trace: list[float] = []
    for _ in range(max_rounds):
        density = expected_log_density(X, mixture, variance_floor)
        top = density.max(axis=1, keepdims=True)
        log_sum = top[:, 0] + np.log(np.exp(density - top).sum(axis=1))
        trace.append(float(log_sum.sum()) + log_prior(mixture, G, kappa))
        has_ended = len(trace) > 1 and trace[-1] - trace[-2] <= tolerance * n
        if not has_ended:
            mixture = maximise(
                X, np.exp(density - log_sum[:, None]), G, kappa, variance_floor
            )
        yield LearnedMixture(_without_empty_components(mixture, n), np.array(trace))
        if has_ended:
            return


def _without_empty_components(mixture: Mixture, n: int) -> Mixture:
    """Return the mixture without components to which hardly one of n shapes belongs."""
    retained = mixture.weights * n > MIN_SHAPES
    weights = mixture.weights[retained]
    means = mixture.means[retained]
    return Mixture(weights / weights.sum(), means, mixture.covariances[retained])


def maximise(
    X: Floats, share: Floats, G: Floats, kappa: float, variance_floor: float
) -> Mixture:
    """Return the likeliest mixture for shares (n, K) of its components in shapes X.

    The maximisation step. X (n, d), the shapes as rows; G, kappa and variance_floor as
    in the objective above.
    """
    count = np.maximum(share.sum(axis=0), 1e-300)
    means = (share.T @ X) / count[:, None]
    prior = variance_floor * np.eye(X.shape[1])

    def covariance_of(k: int) -> Floats:
        """Return the shrunk covariance of component k."""
        scatter = _scatter(X, share[:, k], means[k])
        pulled = scatter + count[k] * prior + kappa * G
        return np.asarray(pulled / (count[k] + kappa))

    covariances = on_threads(covariance_of, range(len(count)), 0)
    weights = count / count.sum()
    return Mixture(weights, means.reshape(len(count), 3, -1), np.stack(covariances))


def expected_log_density(X: Floats, mixture: Mixture, variance_floor: float) -> Floats:
    """Return log pi_k + E log N(X_n + e; mu_k, C_k) (n, K), e ~ N(0, variance_floor I).

    The log densities of shapes X (n, d) that have errors of this variance.
    """
    density = mixture.log_density(X.reshape(len(X), 3, -1))
    traces = (mixture.whitening**2).sum(axis=(1, 2))
    expected: Floats = density - 0.5 * variance_floor * traces
    return expected


def log_prior(mixture: Mixture, G: Floats, kappa: float) -> float:
    """Return the log prior of the covariances, which draws them towards G (d, d).

    -kappa / 2 sum_k (log |C_k| + tr(C_k^-1 G)).
    """
    W = mixture.whitening
    traces = ((W @ G) * W).sum(axis=(1, 2))
    return float(-0.5 * kappa * (mixture.log_determinants + traces).sum())


def kmeans(X: Floats, k: int) -> NDArray[np.intp]:
    """Return the cluster (n,), 0 to k - 1, of each row of X (n, d).

    By Lloyd's method, from the seeds of k-means++.
    """
    centres = _draw_seeds(X, k)
    label = np.zeros(len(X), np.intp)
    doubled = 2 * X
    for _ in range(MAX_KMEANS_ROUNDS):
        before = label
        label = ((centres**2).sum(axis=1) - doubled @ centres.T).argmin(axis=1)
        if (label == before).all():
            break
        for i in range(k):
            inside = label == i
            if inside.any():
                centres[i] = np.ones(inside.sum()) @ X[inside] / inside.sum()
    return label


def _draw_seeds(X: Floats, k: int) -> Floats:
    """Draw centres (k, d) from X (n, d), the likelier the farther from those before.

    Source: k-means++, Arthur and Vassilvitskii 2007.
    """
    rng = np.random.default_rng(0)
    n = len(X)
    uniform = np.ones(n) / n
    centres = X[[rng.choice(n, p=uniform)]]
    nearest = ((X - centres[0]) ** 2).sum(axis=1)
    for _ in range(k - 1):
        chance = nearest / nearest.sum() if nearest.sum() > 0 else uniform
        centres = np.concatenate([centres, X[[rng.choice(n, p=chance)]]])
        nearest = np.minimum(nearest, ((X - centres[-1]) ** 2).sum(axis=1))
    return centres


def _scatter(X: Floats, w: Floats, mean: Floats) -> Floats:
    """Return the scatter matrix sum_n w_n (X_n - mean) (X_n - mean)^T (d, d).

    X (n, d), contiguous, weights w (n,); mean (d,) must be the weighted mean of X.
    """
    d = len(mean)
    total = np.empty((d, d))
    core.sum_outer_products(shapes=X, weights=np.ascontiguousarray(w), total=total)
    scatter: Floats = total - w.sum() * np.outer(mean, mean)
    return scatter
