"""Coefficients of fixed scale: their optimality, an independent solver, and simple cases."""

import numpy as np
import pytest

from shapefit import core


def solve(Q, h, a, start=None):
    x = np.full(len(h), 1 / a.sum()) if start is None else start.copy()
    core.parts.scaled_coefficients(Q, h, a, x)
    return x


@pytest.fixture(params=[1, 2, 7, 30])
def program(request, rng):
    k = request.param
    A = rng.standard_normal((k + 2, k))
    return A.T @ A + 0.1 * np.eye(k), 3 * rng.standard_normal(k), rng.uniform(0.5, 2, k)


def test_conditions_of_optimality_hold(program):
    Q, h, a = program
    x = solve(Q, h, a)
    used = x > 0
    slope = h - Q @ x
    multiplier = (slope[used] / a[used]).mean()
    np.testing.assert_allclose(a @ x, 1.0, rtol=1e-12)
    assert (x >= 0).all()
    np.testing.assert_allclose(slope[used], multiplier * a[used], atol=1e-9)
    assert (slope[~used] <= multiplier * a[~used] + 1e-8).all()


@pytest.mark.slow
def test_an_independent_solver_finds_the_same(program):
    import cvxpy as cp

    Q, h, a = program
    x = cp.Variable(len(h), nonneg=True)
    objective = cp.Minimize(0.5 * cp.quad_form(x, cp.psd_wrap(Q)) - h @ x)
    cp.Problem(objective, [a @ x == 1]).solve(solver=cp.CLARABEL)
    np.testing.assert_allclose(solve(Q, h, a), x.value, atol=1e-6)


def test_the_start_does_not_matter(program, rng):
    Q, h, a = program
    vertex = np.zeros(len(h))
    vertex[-1] = 1 / a[-1]
    np.testing.assert_allclose(solve(Q, h, a, vertex), solve(Q, h, a), atol=1e-9)


def test_a_planted_vertex_is_found():
    x = solve(np.eye(3), np.array([0.0, 5.0, 0.0]), np.array([1.0, 2.0, 1.0]))
    np.testing.assert_array_equal(x, [0.0, 0.5, 0.0])


def test_without_bounds_in_the_way_it_is_the_projection_on_the_plane():
    h, a = np.array([0.5, 0.6]), np.ones(2)
    np.testing.assert_allclose(solve(np.eye(2), h, a), [0.45, 0.55], rtol=1e-12)
