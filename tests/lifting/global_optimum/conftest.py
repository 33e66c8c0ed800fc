"""The model with one rotation by other means: scipy's non-negative least squares at a rotation."""

from collections.abc import Callable

import numpy as np
import pytest
from scipy.optimize import nnls

from shapefit.convex.problem import Problem
from shapefit.geometry.rotations import random_rotations


def best_at(problem: Problem, image: int, rows: np.ndarray) -> tuple[float, np.ndarray]:
    """Return v at a rotation and the multiplier Y (2, p) there, from scipy's nnls.

    With A^T A = U^T U the lasso over c >= 0 is the non-negative least squares of U c = U^-T (A^T w
    - lambda).
    """
    omega = problem.weights[image]
    direction = omega / np.linalg.norm(omega)

    def without_translation(points: np.ndarray) -> np.ndarray:
        weighted = points * omega
        return weighted - (weighted @ direction)[..., None] * direction

    w = without_translation(problem.landmarks[image])
    A = without_translation(rows @ problem.atoms).reshape(len(problem.atoms), -1).T
    lam = problem.lam[image]
    gram = A.T @ A + 1e-12 * np.trace(A.T @ A) * np.eye(A.shape[1])
    upper = np.linalg.cholesky(gram).T
    c, _ = nnls(upper, np.linalg.solve(upper.T, A.T @ w.ravel() - lam), maxiter=10_000)
    Y = w - (A @ c).reshape(2, -1)
    return 0.5 * (Y**2).sum() + lam * c.sum(), Y


@pytest.fixture
def make_planted(rng: np.random.Generator) -> Callable[..., tuple[Problem, np.ndarray, np.ndarray]]:
    """Return a function that makes a problem whose optimum is known by construction.

    A residual Y is chosen, and atoms are turned so that <Y, Rbar B_i> is largest, the nuclear norm
    of Y B_i^T, at one rotation R for all of them, and scaled so that it is lambda for active
    atoms: then Y is feasible at every rotation, and its value is the objective at R.
    """

    def make(n: int = 4, k: int = 8, p: int = 12, *, active: int = 3, weighted: bool = False):
        lam = 0.5
        omega = rng.uniform(0.5, 2, p) if weighted else np.ones(p)
        R = random_rotations(1, rng)[0]
        Y = rng.standard_normal((2, p))
        Y -= (Y @ omega)[:, None] * omega / (omega @ omega)
        atoms = rng.standard_normal((k, 3, p))
        for i, B in enumerate(atoms):
            U, size, Vt = np.linalg.svd((Y * omega) @ B.T, full_matrices=False)
            rows = U @ Vt
            turn = R.T @ np.vstack([rows, np.cross(*rows)])
            norm = lam * (1 if i < active else rng.uniform(0.3, 0.9))
            atoms[i] = turn @ B * norm / size.sum()
        c = np.zeros((n, k))
        c[:, :active] = rng.uniform(1, 3, (n, active))
        W = R[:2] @ np.einsum("nk,kap->nap", c, atoms) + Y / omega
        W += rng.standard_normal((n, 2, 1))
        value = 0.5 * (Y**2).sum() + lam * c.sum(axis=1)
        problem = Problem(W, np.tile(omega, (n, 1)), atoms, np.full(n, lam))
        return problem, np.tile(R, (n, 1, 1)), value

    return make
