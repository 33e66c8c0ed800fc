"""Alternation: monotone, stationary, planted, and against pymanopt with scikit-learn."""

import numpy as np
import pytest

from shapefit.convex.problem import Loss, build_problem
from shapefit.convex.solver import Status
from shapefit.geometry.rotations import random_rotations, rotation_about
from shapefit.lifting.estimate import fit_translation
from shapefit.lifting.shared_rotation import alternate

signs = pytest.mark.parametrize("signed", [False, True])


def nearby(rotation, angle=0.3):
    return (rotation @ rotation_about(np.array([1.0, -1.0, 0.5]), np.array([angle]))[0])[:, None]


def parts(problem, found):
    """Return the weighted residual, the weighted centred atoms, and the objective."""
    c, R = found.coefficients, np.nan_to_num(found.rotation)  # nan where c = 0
    projected = R[:, :2] @ np.einsum("nk,kap->nap", c, problem.atoms)
    placed = fit_translation(problem, projected)
    omega = problem.weights[:, None]
    residual = omega * (problem.landmarks - projected - placed.translation[..., None])
    return residual, placed.half_squared_residual + problem.lam * np.abs(c).sum(axis=1)


@signs
def test_the_objective_never_rises(make_scene, signed):
    """From one round to the next: what fewer rounds end with is never below what more end with."""
    scene = make_scene(n=12, k=20, noise=0.3)
    problem = scene.problem(0.1)
    before = np.inf
    for rounds in (1, 2, 3, 5, 9, 17, 33):
        found = alternate(
            problem, nearby(scene.rotation, 1.0), signed=signed, tolerance=0, max_rounds=rounds
        )
        _, now = parts(problem, found)
        assert (now <= before * (1 + 1e-13)).all()
        before = now


@signs
def test_it_ends_where_neither_step_can_gain(make_scene, signed):
    """Optimal c for R (KKT), vanishing Riemannian gradient in R for c: with weights and T."""
    scene = make_scene(n=20, k=20, noise=0.2, weighted=True, hidden=0.2)
    problem = scene.problem(0.05)
    found = alternate(
        problem, nearby(scene.rotation), signed=signed, tolerance=0.0, max_rounds=20_000
    )
    c, R = found.coefficients, found.rotation
    residual, _ = parts(problem, found)
    pull = problem.weights[:, None] * residual
    assert np.abs(pull.sum(axis=2)).max() < 1e-12  # the translation is optimal
    correlation = np.einsum("nap,nab,kbp->nk", pull, R[:, :2], problem.atoms)
    if not signed:
        assert (c >= 0).all()
    assert (np.abs(correlation) if signed else correlation).max() < 0.05 * (1 + 1e-5)
    np.testing.assert_allclose(correlation[c != 0], 0.05 * np.sign(c[c != 0]), rtol=1e-5)
    S = np.einsum("nk,kap->nap", c, problem.atoms)
    G = -pull @ S.swapaxes(1, 2)
    inner = R[:, :2] @ G.swapaxes(1, 2)
    gradient = G - 0.5 * (inner + inner.swapaxes(1, 2)) @ R[:, :2]
    assert np.abs(gradient).max() < 1e-9 * (S**2).sum(axis=(1, 2)).max()


@pytest.mark.parametrize("weighted", [False, True])
def test_planted_rotations_and_coefficients_come_back(make_scene, weighted):
    """As lambda goes to 0 the planted model is the minimum."""
    scene = make_scene(n=20, k=5, active=3, weighted=weighted, hidden=0.2)
    problem = scene.problem(1e-7)
    found = alternate(problem, nearby(scene.rotation, 0.1), tolerance=1e-12, max_rounds=5000)
    np.testing.assert_allclose(found.coefficients, scene.coefficients, atol=1e-3)
    np.testing.assert_allclose(found.rotation, scene.rotation, atol=1e-3)
    assert set(found.status) == {Status.CONVERGED}


def test_the_best_start_counts(make_scene, rng):
    scene = make_scene(n=15, k=15, noise=0.3)
    problem = scene.problem(0.1)
    starts = np.stack([random_rotations(5, rng) for _ in range(15)])
    alone = [parts(problem, alternate(problem, starts[:, [s]]))[1] for s in range(5)]
    together = alternate(problem, starts)
    np.testing.assert_allclose(parts(problem, together)[1], np.min(alone, axis=0), rtol=1e-12)
    rounds = [alternate(problem, starts[:, [s]]).rounds for s in range(5)]
    np.testing.assert_array_equal(together.rounds, np.sum(rounds, axis=0))


def test_every_image_says_how_it_ended(make_scene):
    scene = make_scene(n=4, noise=0.3)
    scene.weights[2, 1:] = 0.0
    starts = nearby(scene.rotation)
    found = alternate(scene.problem(0.1), starts)
    assert found.status[2] is Status.DEGENERATE
    assert np.isnan(found.rotation[2]).all()
    assert {found.status[image] for image in (0, 1, 3)} == {Status.CONVERGED}
    limited = alternate(scene.problem(0.1), starts, tolerance=0.0, max_rounds=2)
    assert limited.status[0] is Status.ITERATION_LIMIT
    assert limited.rounds[0] == 2


def test_what_it_cannot_do_is_said(make_scene):
    scene = make_scene()
    robust = build_problem(scene.landmarks, scene.atoms, 0.1, loss=Loss.ABSOLUTE)
    with pytest.raises(ValueError, match="squared loss only, not l1"):
        alternate(robust, nearby(scene.rotation))
    with pytest.raises(ValueError, match="starts"):
        alternate(scene.problem(0.1), scene.rotation)
    with pytest.raises(ValueError, match="starts"):
        alternate(scene.problem(0.1), np.zeros((6, 0, 3, 3)))
