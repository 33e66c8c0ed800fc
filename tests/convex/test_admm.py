"""The batched data-space ADMM against the paper's three steps with their 3k x 3k inverses."""

from collections.abc import Callable, Iterator

import numpy as np
import pytest

from shapefit.convex.problem import Problem
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


@pytest.mark.parametrize("weighted", [False, True])
def test_gap_rule_is_certified(
    make_problem: Callable[..., Problem], assert_certified: Callable, weighted: bool
) -> None:
    problem = make_problem(30, 8, 10, weighted=weighted)
    found = solve_admm(problem, tolerance=1e-5, max_iterations=5000)
    assert_certified(problem, found, 1e-5)
    assert (found.iterations % 10 == 0).all()
