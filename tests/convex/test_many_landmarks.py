"""Newton systems in products of atoms: certified, and the same whatever was made
before.
"""

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from shapefit.convex.problem import build_problem
from shapefit.convex.solver import Status, solve_newton
from tests.convex.conftest import assert_certified
from tests.points import transform, with_noise

LARGEST_ITERATIONS = 32
"""A wrong step takes many more."""


def make_images(rng, n, k, p, active, hidden=0.0):
    """Images (n) of a few atoms each, with noise."""
    atoms = rng.normal(size=(k, 3, p))
    transforms = rng.normal(size=(n, k, 2, 3))
    transforms *= rng.random((n, k, 1, 1)) < active / k
    landmarks = with_noise(transform(transforms, atoms), 0.5, rng)
    confidence = rng.choice([0.5, 1.0], size=p)
    visible = rng.random(p) >= hidden
    weights = np.tile(confidence * visible, (n, 1))
    return build_problem(landmarks, atoms, 8.0, weights=weights)


SIZES = [
    (8, 40, 77, 5, 0.0),  # as few unknowns as there may be
    (8, 100, 150, 8, 0.3),
    (40, 600, 120, 8, 0.0),  # all atoms together have no place
    (2, 300, 120, 60, 0.0),  # more rows than unknowns
]


@pytest.mark.parametrize(("n", "k", "p", "active", "hidden"), SIZES)
def test_images_of_many_landmarks_are_certified(rng, n, k, p, active, hidden):
    problem = make_images(rng, n, k, p, active, hidden)

    solution = solve_newton(problem, tolerance=1e-9)

    assert set(solution.status) == {Status.OPTIMAL}
    assert solution.iterations.max() <= LARGEST_ITERATIONS
    assert_certified(problem, solution, 1e-9)


def test_no_bit_depends_on_which_products_were_made_before(rng):
    problem = make_images(rng, 128, 600, 100, 6)
    second_half = problem.take(np.arange(64, 128))

    after_others = solve_newton(problem, threads=1)
    alone = solve_newton(second_half, threads=1)

    assert_array_equal(after_others.objective[64:], alone.objective)
    assert_array_equal(after_others.dual[64:], alone.dual)
    assert_array_equal(after_others.iterations[64:], alone.iterations)
