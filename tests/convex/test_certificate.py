"""The certificate against plain NumPy, weak duality, and hand-made cases."""

from collections.abc import Callable

import numpy as np
import pytest

from shapefit.convex.problem import Loss, Problem
from shapefit.convex.solver import solve_newton
from tests.convex.certificate import certify_transforms


def random_point(
    problem: Problem, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    n, _, p = problem.landmarks.shape
    M = rng.standard_normal((n, len(problem.atoms), 2, 3))
    M *= rng.random((n, len(problem.atoms), 1, 1)) < 0.5
    # a multiple of the landmarks, so that D is often positive
    Y = problem.landmarks * rng.uniform(0, 1, (n, 1, 1)) + 0.3 * rng.standard_normal((n, 2, p))
    E = rng.standard_normal((n, 2, p)) * (rng.random((n, 1, p)) < 0.3)
    return M, Y, E


def test_kernel_agrees_with_numpy(
    make_problem: Callable[..., Problem], judge: Callable, loss: Loss, rng: np.random.Generator
) -> None:
    problem = make_problem(50, loss=loss)
    M, Y, E = random_point(problem, rng)
    if loss.has_quadratic and np.isinf(problem.bound):
        E[:] = 0
    found = certify_transforms(problem, M, Y, E)
    P, D, residual = judge(problem, M, found.translation, Y)
    np.testing.assert_allclose(found.objective, P, rtol=1e-12)
    np.testing.assert_allclose(found.relative_gap, (P - D) / P, rtol=1e-12, atol=1e-13)
    np.testing.assert_allclose(found.residual, residual, rtol=1e-12)
    assert (D > 0).any()
    # T is the mean of what M and E leave, weighted where the loss is quadratic
    omega = problem.weights[:, None, :]
    shapes = np.einsum("nkab,kbp->nap", M, problem.atoms)
    left = omega * (problem.landmarks - shapes - found.translation[..., None]) - E
    visible = omega > 0
    left = np.divide(left, omega, out=np.zeros_like(left), where=visible)
    mean_weights = omega**2 if loss.has_quadratic else visible
    np.testing.assert_allclose((left * mean_weights).sum(axis=2), 0, atol=1e-12)
    # what comes back is feasible and proves the same
    assert np.abs((found.dual * omega).sum(axis=2)).max() < 1e-13
    N = (found.dual * omega)[:, None] @ problem.atoms.swapaxes(1, 2)
    nuclear = np.linalg.svd(N, compute_uv=False).sum(axis=-1)
    assert (nuclear <= problem.lam[:, None] * (1 + 1e-12)).all()
    assert (np.abs(found.dual) <= problem.bound * (1 + 1e-12)).all()
    again = certify_transforms(problem, M, found.dual, E)
    np.testing.assert_allclose(again.relative_gap, found.relative_gap, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("loss", [Loss.SQUARED, Loss.ABSOLUTE, Loss.SPARSE_ERROR])
def test_no_point_lies_below_any_bound(
    make_problem: Callable[..., Problem], rng: np.random.Generator, loss: Loss
) -> None:
    """Weak duality: every P is above every D, near the optimum too."""
    problem = make_problem(10, loss=loss)
    best = solve_newton(problem, tolerance=1e-10)
    for size in (0, 1e-6, 1e-3, 1.0):
        M, Y, _ = random_point(problem, rng)
        found = certify_transforms(
            problem, best.transforms.dense() + size * M, best.dual + size * Y
        )
        P, D = found.objective, found.objective * (1 - found.relative_gap)
        assert (P >= best.objective * (1 - 1e-9)).all()
        assert (D <= best.objective * (1 + 1e-12)).all()
