"""Placing projected shapes on landmarks, and putting some estimates among others."""

from dataclasses import fields, replace

import numpy as np
import pytest
from scipy.optimize import minimize

from shapefit.convex.solver import Status, solve_newton
from shapefit.lifting.estimate import fit_translation, replace_rows
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


def test_a_given_place_is_kept(scene, rng):
    problem, S, T = scene.problem(0.1), rng.standard_normal((5, 2, 12)), rng.normal(size=(5, 2))
    placed = fit_translation(problem, S, T)
    np.testing.assert_array_equal(placed.translation, T)
    left = scene.weights[:, None] * (problem.landmarks - S - T[..., None])
    np.testing.assert_allclose(placed.half_squared_residual, 0.5 * (left**2).sum(axis=(1, 2)))


def test_some_images_are_replaced_and_the_others_are_not(run):
    whole, other = run(0.1), run(1.0)
    rows, rest = np.array([3, 1]), np.array([0, 2, 4])
    some = {
        field.name: getattr(other, field.name)[rows]
        for field in fields(other)
        if isinstance(getattr(other, field.name), np.ndarray)
    }
    status = (Status.ITERATION_LIMIT, Status.DEGENERATE)
    both = replace_rows(replace(other, status=status, **some), rows, whole)
    for name in some:
        np.testing.assert_array_equal(getattr(both, name)[rows], getattr(other, name)[rows])
        np.testing.assert_array_equal(getattr(both, name)[rest], getattr(whole, name)[rest])
    assert (both.status[3], both.status[1]) == status
    assert [both.status[i] for i in rest] == [whole.status[i] for i in rest]
    assert (whole.objective[rows] != other.objective[rows]).all()


def test_what_one_estimate_lacks_cannot_be_put(run):
    with pytest.raises(ValueError, match="coefficients is in one of the estimates only"):
        replace_rows(run(0.1, "mean-shape"), np.arange(5), run(0.1))


def test_further_datasets_are_replaced_too(run):
    whole = replace(run(0.1), further={"sd": np.zeros(5)})
    rows = np.array([3, 1])
    some = {
        field.name: getattr(whole, field.name)[rows]
        for field in fields(whole)
        if isinstance(getattr(whole, field.name), np.ndarray)
    }
    part = replace(whole, status=whole.status[:2], further={"sd": np.array([1.0, 2.0])}, **some)
    found = replace_rows(part, rows, whole)
    np.testing.assert_array_equal(found.further["sd"], [0.0, 2.0, 0.0, 1.0, 0.0])
    with pytest.raises(ValueError, match="further datasets are in one of the estimates only"):
        replace_rows(replace(part, further={}), rows, whole)
