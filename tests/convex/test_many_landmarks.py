"""Newton systems in products of atoms: certified, and the same whatever was made
before.
"""

import numpy as np
import pytest

from shapefit.convex.problem import build_problem
from shapefit.convex.solver import Status, solve_newton
from tests.convex.conftest import assert_certified


def make_images(rng, n, k, p, active, hidden=0.0):
    """Images (n) of a few atoms each, with noise."""
    atoms = rng.normal(size=(k, 3, p))
    blocks = rng.normal(size=(n, k, 2, 3)) * (rng.random((n, k, 1, 1)) < active / k)
    w = np.einsum("nkab,kbp->nap", blocks, atoms) + 0.5 * rng.normal(size=(n, 2, p))
    weights = rng.choice([0.5, 1.0], size=p) * (rng.random(p) >= hidden)
    return build_problem(w, atoms, 8.0, weights=np.tile(weights, (n, 1)))


@pytest.mark.parametrize(
    ("n", "k", "p", "active", "hidden"),
    [
        (8, 40, 77, 5, 0.0),  # as few unknowns as there may be
        (8, 100, 150, 8, 0.3),
        (40, 600, 120, 8, 0.0),  # all atoms together have no place
        (2, 300, 120, 60, 0.0),  # more rows than unknowns
    ],
)
def test_images_of_many_landmarks_are_certified(rng, n, k, p, active, hidden):
    problem = make_images(rng, n, k, p, active, hidden)
    found = solve_newton(problem, tolerance=1e-9)
    assert set(found.status) == {Status.OPTIMAL}
    assert found.iterations.max() <= 32  # a wrong step takes many more
    assert_certified(problem, found, 1e-9)


def test_no_bit_depends_on_which_products_were_made_before(rng):
    problem = make_images(rng, 128, 600, 100, 6)
    one = solve_newton(problem, threads=1)
    last = solve_newton(problem.take(np.arange(64, 128)), threads=1)
    for name in ("objective", "dual", "iterations"):
        np.testing.assert_array_equal(getattr(one, name)[64:], getattr(last, name))
