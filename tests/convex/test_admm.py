"""The batched data-space ADMM against the paper's three steps with their 3k x 3k inverses."""

from collections.abc import Callable, Iterator

import numpy as np
import pytest

from shapefit.convex.newton import solve_newton
from shapefit.convex.problem import Loss, Problem, build_problem
from shapefit.convex.solution import Status
from tests.convex.admm import prox_spectral_norm, solve_admm


def paper_steps(
    W: np.ndarray, B: np.ndarray, lam: float, mu: float
) -> Iterator[tuple[np.ndarray, np.ndarray, float, float]]:
    """Eqs admm1 to admm3 for one image; W (2, p), B (3 k, p); yields M, Y and both residuals.

    Blocks side by side as in the paper, M and Z (2, 3 k); mu changes by the released rule.
    """
    k = len(B) // 3
    Z, Y = np.zeros((2, 3 * k)), np.zeros((2, 3 * k))
    while True:
        Q = (Z - Y / mu).reshape(2, k, 3).swapaxes(0, 1)
        M = prox_spectral_norm(Q, lam / mu).swapaxes(0, 1).reshape(2, 3 * k)
        Z_old = Z
        Z = (W @ B.T + mu * M + Y) @ np.linalg.inv(B @ B.T + mu * np.eye(3 * k))
        Y = Y + mu * (M - Z)
        norm = np.linalg.norm
        primal = norm(M - Z) / max(norm(M), norm(Z))
        dual = mu * norm(Z - Z_old) / norm(Y)
        yield M, Y, primal, dual
        if primal > 10 * dual:
            mu *= 2
        elif dual > 10 * primal:
            mu /= 2


def eliminated(problem: Problem, image: int) -> tuple[np.ndarray, np.ndarray]:
    """W and B of an unweighted problem of the paper's form with the same transforms."""
    omega = problem.weights[image]
    u = omega / np.linalg.norm(omega)
    drop = np.diag(omega) @ (np.eye(len(u)) - np.outer(u, u))
    return problem.landmarks[image] @ drop, (problem.atoms @ drop).reshape(-1, len(u))


@pytest.mark.parametrize("weighted", [False, True])
def test_iterates_are_those_of_the_paper(
    make_problem: Callable[..., Problem], weighted: bool
) -> None:
    problem = make_problem(3, 5, 8, weighted=weighted)
    n = len(problem.landmarks)
    runs = []
    for image in range(n):
        W, B = eliminated(problem, image)
        runs.append((B, paper_steps(W, B, 0.1, 1 / np.abs(W).mean())))
    moved = set()
    for step in range(1, 41):
        found = solve_admm(problem, tolerance=1e-300, stop="change", max_iterations=step)
        assert found.iterations.tolist() == [step] * n
        for image, (B, run) in enumerate(runs):
            M, Y, primal, dual = next(run)
            moved.add(np.sign(np.log10(primal / dual)) * (abs(np.log10(primal / dual)) > 1))
            ours = found.transforms.dense()[image].swapaxes(0, 1).reshape(M.shape)
            np.testing.assert_allclose(ours, M, atol=1e-10)
            # Solution.dual is feasible: the data-space E of Y = -E B^T, shrunk
            E = found.dual[image] @ B.T
            share = (E * Y).sum() / (Y * Y).sum()
            np.testing.assert_allclose(E, share * Y, atol=1e-10 * np.abs(Y).max())
            assert -1 - 1e-12 <= share <= 0
    assert len(moved) > 1  # mu has changed on the way


def test_change_rule_stops_at_the_first_step_that_meets_it(
    make_problem: Callable[..., Problem],
) -> None:
    problem = make_problem(4, 5, 8)
    found = solve_admm(problem, tolerance=1e-3, stop="change")
    for image in range(4):
        W, B = eliminated(problem, image)
        for step, (_, _, primal, dual) in enumerate(paper_steps(W, B, 0.1, 1 / np.abs(W).mean())):
            if max(primal, dual) <= 1e-3:
                assert found.iterations[image] == step + 1
                break
    assert set(found.status) <= {Status.OPTIMAL, Status.CONVERGED}
    for gap, status in zip(found.relative_gap, found.status, strict=True):
        assert (status is Status.OPTIMAL) == (gap <= 1e-3)


def test_a_change_based_stop_does_not_pass_for_a_certificate(
    make_problem: Callable[..., Problem],
) -> None:
    found = solve_admm(make_problem(20, 12, 10), tolerance=0.03, stop="change")
    assert Status.CONVERGED in found.status


@pytest.mark.parametrize("weighted", [False, True])
def test_gap_rule_is_certified(
    make_problem: Callable[..., Problem], assert_certified: Callable, weighted: bool
) -> None:
    problem = make_problem(30, 8, 10, weighted=weighted)
    found = solve_admm(problem, tolerance=1e-5, max_iterations=5000)
    assert_certified(problem, found, 1e-5)
    assert (found.iterations % 10 == 0).all()


def test_images_of_a_batch_do_not_touch_each_other(make_problem: Callable[..., Problem]) -> None:
    problem = make_problem(9, 6, 8)
    together = solve_admm(problem)
    for image in range(9):
        alone = solve_admm(problem.take(np.array([image])))
        np.testing.assert_allclose(
            alone.transforms.dense()[0], together.transforms.dense()[image], atol=1e-12
        )
        assert alone.iterations[0] == together.iterations[image]


def test_iteration_limit_comes_with_its_gap(make_problem: Callable[..., Problem]) -> None:
    problem = make_problem(5)
    found = solve_admm(problem, max_iterations=3)
    best = solve_newton(problem, tolerance=1e-10)
    assert set(found.status) == {Status.ITERATION_LIMIT}
    assert (found.iterations == 3).all()
    assert (found.relative_gap > 1e-4).all()
    true_gap = 1 - best.objective / found.objective
    assert (true_gap <= found.relative_gap + 1e-9).all()


def test_hidden_garbage_few_landmarks_and_zero_landmarks(
    make_problem: Callable[..., Problem],
) -> None:
    problem = make_problem(4)
    landmarks, weights = problem.landmarks.copy(), problem.weights.copy()
    weights[1, 1:] = 0
    weights[2, :] = 0
    landmarks[3] = 0
    clean = solve_admm(Problem(landmarks, weights, problem.atoms, problem.lam))
    optimal, degenerate = Status.OPTIMAL, Status.DEGENERATE
    assert clean.status == (optimal, degenerate, degenerate, optimal)
    assert np.isnan(clean.relative_gap[1:3]).all()
    assert not clean.transforms.dense()[1:].any()
    for garbage in (np.nan, np.inf, 1e300):
        dirty = np.where(weights[:, None, :] > 0, landmarks, garbage)
        found = solve_admm(Problem(dirty, weights, problem.atoms, problem.lam))
        assert (found.transforms.dense() == clean.transforms.dense()).all()
        np.testing.assert_array_equal(found.objective, clean.objective)


@pytest.mark.parametrize("loss", [Loss.EXACT, Loss.ABSOLUTE, Loss.SPARSE_ERROR])
def test_other_losses_are_refused(loss: Loss) -> None:
    problem = build_problem(np.ones((1, 2, 4)), np.ones((2, 3, 4)), 0.1, loss=loss)
    with pytest.raises(ValueError, match=loss.value):
        solve_admm(problem)
