"""The fast solver against the paper's ADMM on a thousand images."""

import numpy as np
import pytest

from shapefit.convex.newton import solve_newton
from shapefit.convex.problem import Problem, build_problem
from shapefit.convex.solution import Status
from tests.convex.admm import solve_admm


def assert_agreement(problem: Problem, iterations: int) -> None:
    """Objectives lie within both certified gaps of each other: [D, P] overlap."""
    fast = solve_newton(problem, tolerance=1e-6)
    reference = solve_admm(problem, tolerance=1e-4, max_iterations=iterations)
    assert set(fast.status) == {Status.OPTIMAL}
    # the reference may run out of iterations: its gap stays honest
    assert np.mean([status is Status.OPTIMAL for status in reference.status]) > 0.8
    assert (reference.relative_gap < 1e-2).all()
    for one, other in ((fast, reference), (reference, fast)):
        bound = one.objective * (1 - one.relative_gap)
        assert (bound <= other.objective * (1 + 1e-12)).all()
    # and so do the fits that are strongly convex in the data: 1/2 ||A - B||^2 <= P - D
    omega = problem.weights[:, None, :]
    difference = (
        np.einsum(
            "nkab,kbp->nap", fast.transforms.dense() - reference.transforms.dense(), problem.atoms
        )
        + (fast.translation - reference.translation)[..., None]
    )
    distance = np.linalg.norm((omega * difference).reshape(len(omega), -1), axis=1)
    room = np.sqrt(2 * fast.objective * fast.relative_gap.clip(0))
    room += np.sqrt(2 * reference.objective * reference.relative_gap.clip(0))
    assert (distance <= room * (1 + 1e-6) + 1e-9).all()


@pytest.mark.real_data
def test_real_images(real_views: tuple[np.ndarray, np.ndarray], rng: np.random.Generator) -> None:
    """Two hundred people with all 64 atoms, every other one masked or weighted."""
    views, atoms = real_views
    weights = np.ones((200, 15))
    weights[1::4] = rng.random((50, 15)) > 0.3
    weights[3::4] = rng.uniform(0.1, 1, (50, 15))
    assert_agreement(build_problem(views[::5], atoms, 0.1, weights=weights), 1000)
