"""The solvers beside which `make bench` sets this one find the same optimum."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from benchmarks.peers import (
    TOLERANCE,
    admm_solvers,
    clarabel_solvers,
    count_iterations,
    inverse_of_gram,
    run_admm,
)
from shapefit.convex.problem import build_problem
from shapefit.convex.solver import solve_newton
from shapefit.geometry.normalisation import normalise

LAMBDA = 0.1


@pytest.fixture(scope="module")
def program():
    """Images (n, 2, p), atoms (k, 3, p), and the optimum of each image."""
    rng = np.random.default_rng(4)
    atoms = normalise(rng.normal(size=(6, 3, 8))).points
    atoms /= np.linalg.norm(atoms, axis=(1, 2))[:, None, None]
    w = normalise(rng.normal(size=(4, 2, 8))).points
    solution = solve_newton(build_problem(w, atoms, LAMBDA), tolerance=1e-10)
    return w, atoms, solution.objective


def test_admm_converges_to_the_certified_optimum(program):
    w, atoms, optimum = program
    B = np.concatenate(atoms)
    inverse = inverse_of_gram(B)
    found = [run_admm(image, B, LAMBDA, inverse, 5000) for image in w]
    assert_allclose(found, optimum, rtol=1e-7)


def test_admm_stops_as_soon_as_the_gap_is_small_enough(program):
    w, atoms, optimum = program
    B = np.concatenate(atoms)
    inverse = inverse_of_gram(B)
    enough = (1 + TOLERANCE) * optimum[0]
    n = count_iterations(w[0], B, LAMBDA, inverse, enough)
    assert run_admm(w[0], B, LAMBDA, inverse, n) <= enough
    assert run_admm(w[0], B, LAMBDA, inverse, n - 1) > enough
    solve, *_ = admm_solvers(w, atoms, LAMBDA, optimum)
    assert solve() <= enough


@pytest.mark.slow
def test_clarabel_comes_as_near_to_the_optimum(program):
    w, atoms, optimum = program
    found = [solve() for solve in clarabel_solvers(w, atoms, LAMBDA, optimum)]
    assert_allclose(found, optimum, rtol=TOLERANCE)
