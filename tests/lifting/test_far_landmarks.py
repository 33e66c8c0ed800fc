"""Landmarks far from the origin are the same problem: no method loses digits to where they lie.

Landmarks are multiples of 2^-10, so that those 2^38 away are the same numbers to the last bit.
"""

import time

from shapefit.convex.problem import build_problem
from shapefit.convex.solver import Status
from shapefit.lifting.global_optimum.method import Limits, find_optimum


def test_the_search_keeps_to_its_seconds(make_scene, rng):
    """Landmarks of no shape, to a gap that takes seconds; the best of three, as others work too.

    Two thirds of the time belong to the gap that is asked for, the rest to looser ones.
    """
    atoms = make_scene(n=1, k=30, p=20).atoms
    problem = build_problem(rng.standard_normal((1, 2, 20)), atoms, 0.002)
    limits = Limits(10**6, 0.3)
    seconds = []
    for _ in range(3):
        began = time.monotonic()
        found = find_optimum(problem, tolerance=1e-9, limits=limits, threads=1)
        seconds.append(time.monotonic() - began)
        assert found.status == (Status.ITERATION_LIMIT,)
        assert 0 < found.bound[0] < found.objective[0]
    assert 2 / 3 * limits.seconds < min(seconds) < 3 * limits.seconds  # seven times without
