"""Landmarks far from the origin are the same problem: no method loses digits to where they lie.

Landmarks are multiples of 2^-10, so that those 2^38 away are the same numbers to the last bit.
"""

import time
from dataclasses import replace

import numpy as np
import pytest

from shapefit.convex.problem import build_problem
from shapefit.convex.solver import Status
from shapefit.geometry.rotations import random_rotations
from shapefit.lifting.global_optimum.method import Limits, find_optimum
from shapefit.lifting.matching_pursuit import pursue
from shapefit.lifting.shared_rotation.pose import alternate

FAR = 2.0**38


@pytest.fixture
def here_and_far(make_scene):
    scene = make_scene(n=5, k=6, p=9, noise=0.1)
    scene = replace(scene, landmarks=np.round(scene.landmarks * 2**10) / 2**10)
    return scene, scene.problem(0.2), replace(scene, landmarks=scene.landmarks + FAR).problem(0.2)


def test_the_global_optimum_and_its_bound(here_and_far):
    _, here, far = here_and_far
    found, same = (find_optimum(problem, tolerance=1e-3, threads=1) for problem in (here, far))
    np.testing.assert_allclose(same.objective, found.objective, rtol=1e-12)
    assert (same.bound <= found.objective).all()
    np.testing.assert_allclose(same.rotation, found.rotation, atol=1e-9)


def test_alternation(here_and_far, rng):
    _, here, far = here_and_far
    starts = random_rotations(10, rng).reshape(5, 2, 3, 3)
    found, same = (alternate(problem, starts, threads=1) for problem in (here, far))
    np.testing.assert_allclose(same.coefficients, found.coefficients, atol=1e-9)
    np.testing.assert_allclose(same.rotation, found.rotation, atol=1e-9)


def test_pursuit(here_and_far):
    scene, here, far = here_and_far
    edges = np.array([[0, 1], [1, 2], [2, 3]])
    found, same = (pursue(problem, scene.mean_shape, edges, threads=1) for problem in (here, far))
    np.testing.assert_allclose(same.error, found.error, rtol=1e-9)
    np.testing.assert_allclose(same.coefficients, found.coefficients, atol=1e-9)


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
