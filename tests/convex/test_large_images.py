"""Large images, whose loops several threads share: no bit depends on how many."""

import time

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from shapefit.convex.problem import Loss, build_problem
from shapefit.convex.solver import Status, solve_newton
from tests.convex.conftest import assert_certified

ATOMS, LANDMARKS = 300, 200
"""Enough that the loops are shared, and no more."""

TOLERANCE = 1e-6


def make_images(rng, loss=Loss.SQUARED, n=2):
    atoms = rng.normal(size=(ATOMS, 3, LANDMARKS))
    landmarks = rng.normal(size=(n, 2, LANDMARKS))
    return build_problem(landmarks, atoms, 20.0, loss=loss)


def make_degenerate_images(rng):
    """Landmarks on one point, a single landmark, half of them; each atom twice."""
    half = ATOMS // 2
    atoms = rng.normal(size=(half, 3, LANDMARKS))
    landmarks = rng.normal(size=(4, 2, LANDMARKS))
    landmarks[1] = 3.0
    landmarks[2, :, 1:] = np.nan
    landmarks[3, :, : LANDMARKS // 4] = np.nan
    return build_problem(landmarks, np.concatenate([atoms, atoms]), 20.0)


def assert_same_on_any_threads(problem):
    """Return the solution, the same with one, two and three threads."""
    alone = solve_newton(problem, tolerance=TOLERANCE, threads=1)
    for threads in (2, 3):
        together = solve_newton(problem, tolerance=TOLERANCE, threads=threads)
        assert together.status == alone.status
        for name in ("iterations", "objective", "relative_gap", "dual", "errors"):
            assert_array_equal(getattr(together, name), getattr(alone, name))
        assert_array_equal(together.transforms.blocks, alone.transforms.blocks)
    return alone


@pytest.mark.parametrize("loss", Loss)
def test_no_bit_depends_on_how_many_threads_share_an_image(rng, loss):
    problem = make_images(rng, loss)

    solution = assert_same_on_any_threads(problem)

    assert set(solution.status) == {Status.OPTIMAL}
    assert_certified(problem, solution, TOLERANCE)


def test_no_bit_depends_on_threads_where_images_are_degenerate(rng):
    solution = assert_same_on_any_threads(make_degenerate_images(rng))

    assert solution.status[2] is Status.DEGENERATE
    assert {solution.status[i] for i in (0, 1, 3)} == {Status.OPTIMAL}


def time_elsewhere(problem, threads):
    """Return the share of the CPU time that other threads than this one took."""
    begin = time.process_time()
    begin_here = time.thread_time()
    solve_newton(problem, tolerance=TOLERANCE, threads=threads)
    here = time.thread_time() - begin_here
    return 1 - here / (time.process_time() - begin)


def test_another_thread_takes_parts_of_a_single_image(rng):
    problem = make_images(rng, n=1)
    solve_newton(problem, threads=1)

    assert time_elsewhere(problem, threads=1) < 0.01
    assert time_elsewhere(problem, threads=2) > 0.1
