"""Placing projected shapes on landmarks, and putting some estimates among others."""

from dataclasses import fields, replace

import numpy as np
import pytest
from scipy.optimize import minimize

from shapefit.convex.solver import solve_newton
from shapefit.lifting.estimate import fit_translation, join_images
from shapefit.lifting.methods import Settings, choose_method


@pytest.fixture
def scene(make_scene):
    return make_scene(n=5, noise=0.3, weighted=True, hidden=0.2)


@pytest.fixture
def run(scene):
    def run(lam, method="convex+refine"):
        settings = Settings(solve=solve_newton, mean_shape=scene.mean_shape)
        return choose_method(method, settings)(scene.problem(lam))

    return run


def test_a_shape_is_placed_where_no_other_place_is_better(scene, rng):
    problem, S = scene.problem(0.1), rng.standard_normal((5, 2, 12))
    placed = fit_translation(problem, S)
    for i in range(5):
        w = scene.weights[i]

        def half_squared_residual(T, points=problem.landmarks[i], w=w):
            return 0.5 * ((w * (points - T[:, None])) ** 2).sum()

        best = minimize(
            half_squared_residual, np.zeros(2), args=(problem.landmarks[i] - S[i], w), tol=1e-12
        )
        np.testing.assert_allclose(placed.translation[i], best.x, atol=1e-6)
        np.testing.assert_allclose(placed.half_squared_residual[i], best.fun, rtol=1e-9)
        whole = minimize(half_squared_residual, np.zeros(2), tol=1e-12).fun
        np.testing.assert_allclose(placed.residual[i], np.sqrt(best.fun / whole), rtol=1e-9)


def test_images_of_two_estimates_are_joined_in_the_order_asked_for(run):
    one, other = (replace(run(lam), further={"sd": np.full(5, lam)}) for lam in (0.1, 1.0))
    order = np.array([7, 0, 5, 3])
    both = join_images([one, other], order)
    for field in fields(one):
        first, second = getattr(one, field.name), getattr(other, field.name)
        if isinstance(first, np.ndarray):
            expected = np.stack([second[2], first[0], second[0], first[3]])
            np.testing.assert_array_equal(getattr(both, field.name), expected)
    assert both.status == (other.status[2], one.status[0], other.status[0], one.status[3])
    np.testing.assert_array_equal(both.further["sd"], [1.0, 0.1, 1.0, 0.1])
    np.testing.assert_array_equal(
        both.transforms.dense()[[0, 1]],
        [other.transforms.dense()[2], one.transforms.dense()[0]],
    )
