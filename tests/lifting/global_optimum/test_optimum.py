"""The global optimum: planted answers, other methods, random descents, limits."""

from dataclasses import replace
from functools import partial

import h5py
import numpy as np
import pytest

from shapefit.convex.problem import Loss, build_problem
from shapefit.convex.solver import Status, solve_newton
from shapefit.geometry.normalisation import normalise
from shapefit.geometry.rotations import random_rotations
from shapefit.lifting.estimate import fit_translation
from shapefit.lifting.global_optimum import find_optimum
from shapefit.lifting.methods import Settings, choose_method
from shapefit.lifting.reconstruction import combine
from shapefit.lifting.shared_rotation import alternate
from tests.lifting.global_optimum.conftest import best_at


def objective_of(problem, starts):
    """The least objective (n,) of descents from rotations (n, s, 3, 3)."""
    c, R = (found := alternate(problem, starts)).coefficients, np.nan_to_num(found.rotation)
    placed = fit_translation(problem, combine(c, problem.atoms, R))
    return placed.half_squared_residual + problem.lam * c.sum(axis=1)


@pytest.mark.parametrize("weighted", [False, True])
def test_a_planted_optimum_is_found_with_a_gap_of_rounding(make_planted, weighted):
    problem, R, value = make_planted(weighted=weighted)
    found = find_optimum(problem, tolerance=1e-9, threads=1)
    assert set(found.status) == {Status.OPTIMAL}
    np.testing.assert_allclose(found.objective, value, rtol=1e-12)
    np.testing.assert_allclose(found.rotation, R, atol=1e-5)
    assert (found.bound <= value * (1 + 1e-13)).all()
    assert (found.relative_gap <= 1.1e-9).all()


def test_the_objective_is_that_of_an_independent_solver_at_the_rotation(make_scene):
    problem = make_scene(n=4, noise=0.3, weighted=True, hidden=0.2).problem(0.2)
    found = find_optimum(problem, threads=1)
    for image, R in enumerate(found.rotation):
        assert best_at(problem, image, R[:2])[0] == pytest.approx(found.objective[image], rel=1e-8)


@pytest.mark.parametrize("hidden", [0.0, 0.25])
def test_it_is_never_above_other_methods_and_the_bound_never_above_any_rotation(
    make_scene, hidden, rng
):
    scene = make_scene(n=12, k=12, noise=0.4, weighted=bool(hidden), hidden=hidden)
    problem = scene.problem(0.2)
    solve = partial(solve_newton, tolerance=1e-8)
    settings = Settings(solve=solve, mean_shape=scene.mean_shape, tolerance=0.01)
    found = choose_method("global", settings)(problem)
    assert set(found.status) == {Status.OPTIMAL}
    assert (found.relative_gap <= 0.01 + 1e-10).all()
    bound = found.objective * (1 - found.relative_gap)
    for name in ("convex+refine", "alternate"):
        other = choose_method(name, settings)(problem).objective
        assert (found.objective <= other * (1 + 1e-9)).all()
        assert (bound <= other).all()
    starts = random_rotations(12 * 20, rng).reshape(12, 20, 3, 3)
    assert (bound <= objective_of(problem, starts)).all()


def test_a_limit_leaves_a_bound_that_holds(make_scene):
    problem = make_scene(n=5, noise=0.3).problem(0.2)
    full = find_optimum(problem, tolerance=1e-3, threads=1)
    for cells in (1, 200, 600):
        cut_short = find_optimum(problem, tolerance=1e-3, max_cells=cells, threads=1)
        assert set(cut_short.status) == {Status.ITERATION_LIMIT}
        assert (cut_short.cells <= 2 * cells).all()
        assert (cut_short.bound <= full.objective).all()
        assert (cut_short.bound >= 0).all()
        assert (cut_short.relative_gap > 1e-3).all()
    assert (cut_short.bound > 0.5 * full.objective).all()
    none = find_optimum(problem, tolerance=1e-3, max_seconds=1e-9, threads=1)
    assert set(none.status) == {Status.ITERATION_LIMIT}


def test_one_landmark_is_degenerate_and_other_losses_are_refused(make_scene):
    problem = make_scene(n=2).problem(0.2)
    weights = problem.weights.copy()
    weights[1, 1:] = 0
    found = find_optimum(replace(problem, weights=weights), threads=1)
    assert found.status == (Status.OPTIMAL, Status.DEGENERATE)
    with pytest.raises(ValueError, match="squared loss only"):
        find_optimum(replace(problem, loss=Loss.ABSOLUTE))
    with pytest.raises(ValueError, match="starts"):
        find_optimum(problem, np.zeros((2, 3, 3)))


@pytest.mark.real_data
def test_people_are_certified_and_no_descent_gets_below_the_bound(real_data, rng):
    """Every 1,500th frame of subject 13, from random views, with atoms drawn from subject 86."""
    with h5py.File(real_data / "mocap/subject86_24fps.h5") as file:
        shapes = file["shapes"][::150].swapaxes(1, 2)
        names = file["landmark_names"][:]
    with h5py.File(real_data / "mocap/subject13_24fps.h5") as file:
        assert (file["landmark_names"][:] == names).all()
        truth = file["shapes"][::1500].swapaxes(1, 2)
    atoms = normalise(shapes).points
    R = random_rotations(len(truth), rng)
    problem = build_problem(normalise((R @ truth)[:, :2]).points, atoms, 0.1)
    mean = atoms.mean(axis=0)
    settings = Settings(solve=partial(solve_newton, tolerance=1e-6), mean_shape=mean)
    found = choose_method("global", settings)(problem)
    assert set(found.status) == {Status.OPTIMAL}
    for name in ("convex+refine", "alternate"):
        other = choose_method(name, settings)(problem).objective
        assert (found.objective <= other * (1 + 1e-9)).all()
    starts = random_rotations(30 * len(truth), rng).reshape(len(truth), 30, 3, 3)
    assert (objective_of(problem, starts) >= found.objective * (1 - found.relative_gap)).all()
