"""Statuses of the fast solver, each with its certificate, and the symmetries of the program."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from shapefit.convex.problem import Loss, Problem, build_problem
from shapefit.convex.solver import Status, solve_newton
from shapefit.convex.transforms import nuclear_norm


@pytest.mark.parametrize("tolerance", [1e-2, 1e-4, 1e-6, 1e-8])
def test_every_image_is_certified(
    make_problem: Callable[..., Problem], assert_certified: Callable, loss: Loss, tolerance: float
) -> None:
    problem = make_problem(40, loss=loss)
    assert_certified(problem, solve_newton(problem, tolerance=tolerance), tolerance)


def test_iteration_limit_comes_with_its_honest_gap(
    make_problem: Callable[..., Problem], judge: Callable, loss: Loss
) -> None:
    problem = make_problem(20, loss=loss)
    found = solve_newton(problem, max_iterations=2)
    assert Status.ITERATION_LIMIT in found.status
    assert (found.iterations <= 2).all()
    P, D, residual = judge(problem, found.transforms.dense(), found.translation, found.dual)
    for image, status in enumerate(found.status):
        gap = (P[image] - D[image]) / P[image]
        met = loss is not Loss.EXACT or residual[image] <= 1e-4
        honest = pytest.approx(gap if met else np.nan, rel=1e-9, abs=1e-12, nan_ok=True)
        assert found.relative_gap[image] == honest
        assert (status is Status.OPTIMAL) == (met and abs(gap) <= 1e-4)


def test_few_visible_landmarks(make_problem: Callable[..., Problem], loss: Loss) -> None:
    problem = make_problem(70, loss=loss)
    weights = problem.weights.copy()
    weights[3, 1:] = 0
    weights[4] = 0
    weights[66:, 1:] = 0
    found = solve_newton(replace(problem, weights=weights))
    lost = np.isin(np.arange(70), [3, 4, 66, 67, 68, 69])
    assert [status is Status.DEGENERATE for status in found.status] == lost.tolist()
    assert {found.status[i] for i in np.flatnonzero(~lost)} == {Status.OPTIMAL}
    for values in (found.objective, found.relative_gap, found.residual):
        assert (np.isnan(values) == lost).all()
    assert not found.transforms.dense()[lost].any()
    # the neighbours do not feel it
    alone = solve_newton(replace(problem, weights=weights).take(np.array([2, 5])))
    np.testing.assert_allclose(alone.objective, found.objective[[2, 5]], rtol=2e-4)


def test_overflow_is_a_numerical_failure_and_spares_the_next(
    make_problem: Callable[..., Problem], loss: Loss
) -> None:
    problem = make_problem(3, loss=loss)
    landmarks = problem.landmarks.copy()
    landmarks[1] *= 1e200
    found = solve_newton(replace(problem, landmarks=landmarks))
    assert found.status == (Status.OPTIMAL, Status.NUMERICAL_FAILURE, Status.OPTIMAL)


def test_exact_program_without_a_solution_is_never_optimal(rng: np.random.Generator) -> None:
    problem = build_problem(
        rng.standard_normal((5, 2, 9)), rng.standard_normal((1, 3, 9)), 1.0, loss=Loss.EXACT
    )
    found = solve_newton(problem)
    assert Status.OPTIMAL not in found.status
    assert (found.residual > 0.1).all()


@pytest.mark.parametrize("second", [1.0, 1 - 1e-9, 1e-9, 0.0])
@pytest.mark.parametrize("size", [1e-60, 1.0, 1e60])
def test_the_nuclear_norm_is_the_sum_of_singular_values(
    rng: np.random.Generator, second: float, size: float
) -> None:
    U, V = (np.linalg.qr(rng.standard_normal((m, m)))[0] for m in (2, 3))
    blocks = size * (U @ np.diag([1.0, second]) @ V[:2])
    np.testing.assert_allclose(nuclear_norm(blocks), size * (1 + second), rtol=1e-14)
