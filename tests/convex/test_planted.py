"""Problems built from their own optimum."""

from dataclasses import dataclass

import numpy as np
import pytest

from shapefit.convex.problem import Loss, Problem, build_problem
from shapefit.convex.solver import Status, solve_newton

LAM, BETA = 0.7, 0.4


@dataclass(frozen=True)
class Planted:
    problem: Problem
    transforms: np.ndarray
    translation: np.ndarray
    dual: np.ndarray
    objective: float


def plant(seed: int, loss: Loss, *, weighted: bool, k: int = 9, p: int = 14) -> Planted:
    """Choose a dual Y, scale atoms until those that shall be active touch the bound, set W.

    Y omega = 0 and Y = 0 where hidden; ||(Omega o Y) B_i^T||_* = lambda where M_i = c_i U V^T from
    the SVD of (Omega o Y) B_i^T, less elsewhere; r is in the subdifferential of f* at Y.
    """
    rng = np.random.default_rng(seed)
    omega = np.ones(p)
    if weighted:
        omega = rng.uniform(0.3, 1.5, p) * (np.arange(p) % 5 != 4)
    if loss is Loss.EXACT:
        omega = (omega > 0).astype(float)
    bound = {Loss.ABSOLUTE: 1.0, Loss.SPARSE_ERROR: BETA}.get(loss, np.inf)
    Y = 0.25 * min(bound, 4.0) * rng.uniform(-1, 1, (2, p)) * (omega > 0)
    outlier = np.zeros((2, p), dtype=bool)
    if np.isfinite(bound):
        outlier[:, 2] = outlier[0, 6] = True
        Y[outlier] = bound * rng.choice([-1, 1], 3)
    free = ~outlier * omega
    Y -= (Y @ omega / (free @ omega))[:, None] * free
    assert (np.abs(Y[~outlier]) < 0.95 * bound).all()
    np.testing.assert_allclose(Y @ omega, 0, atol=1e-14)

    atoms = rng.standard_normal((k, 3, p))
    nuclear = np.linalg.svd((Y * omega) @ atoms.swapaxes(1, 2), compute_uv=False).sum(axis=1)
    active = np.arange(k) < 3
    touch = np.where(active, 1.0, rng.uniform(0.2, 0.9, k))
    atoms *= (LAM * touch / nuclear)[:, None, None]
    U, _, Vt = np.linalg.svd((Y * omega) @ atoms.swapaxes(1, 2), full_matrices=False)
    c = rng.uniform(0.5, 2, k) * active
    M = c[:, None, None] * (U @ Vt)
    T = rng.standard_normal(2)

    gross = np.sign(Y) * outlier * rng.uniform(0.5, 2, (2, p))
    residual = {
        Loss.SQUARED: Y,
        Loss.EXACT: np.zeros((2, p)),
        Loss.ABSOLUTE: gross,
        Loss.SPARSE_ERROR: Y + gross,
    }[loss]
    f = {
        Loss.SQUARED: 0.5 * (Y**2).sum(),
        Loss.EXACT: 0.0,
        Loss.ABSOLUTE: np.abs(gross).sum(),
        Loss.SPARSE_ERROR: 0.5 * (Y**2).sum() + BETA * np.abs(gross).sum(),
    }[loss]
    shape = np.einsum("kab,kbp->ap", M, atoms) + T[:, None]
    W = shape + np.divide(residual, omega, out=np.zeros((2, p)), where=omega > 0)
    W[:, omega == 0] = np.nan
    problem = build_problem(W, atoms, LAM, weights=omega[None], loss=loss, beta=BETA)
    return Planted(problem, M, T, Y, f + LAM * c.sum())


@pytest.mark.parametrize("weighted", [False, True], ids=["plain", "weighted"])
@pytest.mark.parametrize("seed", range(5))
def test_planted_optimum_is_found(loss: Loss, seed: int, weighted: bool) -> None:
    planted = plant(seed, loss, weighted=weighted)
    found = solve_newton(planted.problem, tolerance=1e-11)
    assert found.status == (Status.OPTIMAL,)
    assert found.objective[0] == pytest.approx(planted.objective, rel=1e-10)
    # the active atoms are in general position, so the optimum is the only one
    np.testing.assert_allclose(found.transforms.dense()[0], planted.transforms, atol=1e-4)
    np.testing.assert_allclose(found.translation[0], planted.translation, atol=1e-4)
    if loss.has_quadratic:  # D is strongly concave, so Y is unique
        np.testing.assert_allclose(found.dual[0], planted.dual, atol=1e-4)
