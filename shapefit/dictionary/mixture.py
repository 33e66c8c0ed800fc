"""A prior over shapes: a mixture of Gaussians over normalised, aligned shapes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from shapefit.arrays import Floats, Integers


@dataclass(frozen=True, eq=False)
class Mixture:
    """p(x) = sum_k pi_k N(x; mu_k, C_k) over shapes x, flattened: all x, then all y, then all z.

    weights pi (K,), positive, with the sum 1; means mu (K, 3, p); covariances C (K, 3p, 3p).
    """

    weights: Floats
    means: Floats
    covariances: Floats

    def __len__(self) -> int:
        return len(self.weights)

    @property
    def by_landmark(self) -> Floats:
        """Covariances as (K, p, 3, p, 3)."""
        k, _, p = self.means.shape
        return self.covariances.reshape(k, 3, p, 3, p).transpose(0, 2, 1, 4, 3)

    @classmethod
    def of_landmarks(cls, weights: Floats, means: Floats, by_landmark: Floats) -> Mixture:
        """Make the mixture from covariances (K, p, 3, p, 3)."""
        k, _, p = means.shape
        C = by_landmark.transpose(0, 2, 1, 4, 3).reshape(k, 3 * p, 3 * p)
        return cls(weights, means, C)

    def marginal(self, landmarks: Integers) -> Mixture:
        """Return the mixture over some of the landmarks, in this order."""
        C = np.take(np.take(self.by_landmark, landmarks, axis=1), landmarks, axis=3)
        return self.of_landmarks(self.weights, np.take(self.means, landmarks, axis=2), C)

    def log_density(self, shapes: Floats) -> Floats:
        """log(pi_k N(x_n; mu_k, C_k)) for shapes (n, 3, p): (n, K)."""
        x = shapes.reshape(len(shapes), -1)
        found = np.empty((len(x), len(self)))
        for k, (mean, covariance) in enumerate(zip(self.means, self.covariances, strict=True)):
            L = np.linalg.cholesky(covariance)
            z = np.linalg.solve(L, (x - mean.ravel()).T)
            log_size = np.log(np.diag(L)).sum() + 0.5 * len(L) * np.log(2 * np.pi)
            found[:, k] = np.log(self.weights[k]) - 0.5 * (z * z).sum(axis=0) - log_size
        return found
