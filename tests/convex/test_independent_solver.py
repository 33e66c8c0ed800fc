"""The fast solver against cvxpy with Clarabel, which shares no line and no idea with it."""

from collections.abc import Callable

import numpy as np
import pytest

from shapefit.convex.problem import Loss, Problem, build_problem
from shapefit.convex.solver import Status, solve_newton

pytestmark = pytest.mark.slow  # cvxpy comes with the packages of the slow tests


class Clarabel:
    """The program of one image as the paper writes it, built once for a size and a loss."""

    def __init__(self, k: int, p: int, loss: Loss) -> None:
        import cvxpy as cp

        self.W, self.omega = cp.Parameter((2, p)), cp.Parameter((1, p))
        self.B, self.lam = cp.Parameter((3 * k, p)), cp.Parameter(nonneg=True)
        self.beta = cp.Parameter(nonneg=True)
        M, T, E = [cp.Variable((2, 3)) for _ in range(k)], cp.Variable((2, 1)), cp.Variable((2, p))
        r = self.W - cp.hstack(M) @ self.B - T @ self.omega  # weights are in W and B already
        f = {
            Loss.SQUARED: cp.sum_squares(r) / 2,
            Loss.EXACT: cp.Constant(0),
            Loss.ABSOLUTE: cp.sum(cp.abs(r)),
            Loss.SPARSE_ERROR: cp.sum_squares(r - E) / 2 + self.beta * cp.sum(cp.abs(E)),
        }[loss]
        norms = cp.sum(cp.hstack([cp.sigma_max(block) for block in M]))
        constraints = [r == 0] if loss is Loss.EXACT else []
        self.program = cp.Problem(cp.Minimize(f + self.lam * norms), constraints)
        assert self.program.is_dpp()

    def solve(self, problem: Problem, image: int) -> float:
        omega = problem.weights[image]
        self.W.value = problem.landmarks[image] * omega
        self.omega.value = omega[None]
        self.B.value = (problem.atoms * omega).reshape(-1, len(omega))
        self.lam.value, self.beta.value = problem.lam[image], problem.beta
        self.program.solve(solver="CLARABEL")  # to 1e-8, or as near as it gets
        return float(self.program.value)


def assert_agreement(problem: Problem) -> None:
    found = solve_newton(problem, tolerance=1e-9)
    assert set(found.status) == {Status.OPTIMAL}
    judge = Clarabel(len(problem.atoms), problem.landmarks.shape[2], problem.loss)
    expected = [judge.solve(problem, image) for image in range(len(problem.landmarks))]
    size = 1e-9 * np.abs(problem.landmarks).max()  # an absolute accuracy, where all is zero
    np.testing.assert_allclose(found.objective, expected, rtol=1e-6, atol=size)


@pytest.mark.parametrize(("n", "k", "p"), [(80, 3, 5), (60, 7, 8), (40, 12, 10)])
def test_squared_loss_on_random_images(
    make_problem: Callable[..., Problem], rng: np.random.Generator, n: int, k: int, p: int
) -> None:
    problem = make_problem(n, k, p)
    lam = 10 ** rng.uniform(-2, 0.5, n)
    assert_agreement(build_problem(problem.landmarks, problem.atoms, lam, weights=problem.weights))


@pytest.mark.parametrize("loss", [Loss.EXACT, Loss.ABSOLUTE, Loss.SPARSE_ERROR])
@pytest.mark.parametrize(("k", "p"), [(4, 6), (9, 9)])
def test_other_losses_on_random_images(
    make_problem: Callable[..., Problem], loss: Loss, k: int, p: int
) -> None:
    assert_agreement(make_problem(10, k, p, loss=loss))
