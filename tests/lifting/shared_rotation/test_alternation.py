"""Alternation: monotone, stationary, planted, and against pymanopt with scikit-learn."""

import numpy as np
import pymanopt
import pytest
from pymanopt.manifolds import Stiefel
from pymanopt.optimizers import TrustRegions

from shapefit.convex.problem import Loss, build_problem
from shapefit.convex.solver import Status, solve_newton
from shapefit.geometry.rotations import random_rotations, rotation_about
from shapefit.lifting.estimate import fit_translation
from shapefit.lifting.shared_rotation.pose import alternate

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
    return residual, placed.misfit + problem.lam * np.abs(c).sum(axis=1)


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


@signs
def test_a_planted_minimum_stays(make_scene, rng, signed):
    """A residual orthogonal to all tangents, with correlations lam on the support, is stationary.

    Atoms are bent until those conditions hold: from the planted point nothing moves.
    """
    lam, k, p = 0.1, 6, 14
    R = random_rotations(1, rng)
    atoms = rng.standard_normal((k, 3, p))
    atoms -= atoms.mean(axis=2, keepdims=True)
    c = np.array([1.5, -1.0 if signed else 1.0, 0.7, 0.0, 0.0, 0.0])
    residual = 0.1 * rng.standard_normal((2, p))
    residual -= residual.mean(axis=1, keepdims=True)
    # Correlations N_i = residual B_i^T R^T (2 x 3) that keep R and c: lam sign(c_i) / 2 I, 0.
    basis = residual.T @ np.linalg.inv(residual @ residual.T)
    for i in range(k):
        want = np.zeros((2, 3))
        want[:, :2] = 0.5 * lam * (np.sign(c[i]) if c[i] else 0.5) * np.eye(2)
        have = residual @ atoms[i].T @ R[0].T
        atoms[i] += (basis @ (want - have) @ R[0]).T
    W = R[0, :2] @ np.tensordot(c, atoms, axes=1) + residual
    found = alternate(build_problem(W[None], atoms, lam), R[:, None], signed=signed, tolerance=0.0)
    np.testing.assert_allclose(found.coefficients[0], c, atol=1e-8)
    np.testing.assert_allclose(found.rotation, R, atol=1e-8)


@pytest.mark.slow
@signs
def test_pymanopt_and_scikit_learn_walk_the_same_way(make_scene, signed):
    from sklearn.linear_model import Lasso

    scene = make_scene(n=4, k=10, noise=0.3)
    lam, rounds, manifold = 0.1, 6, Stiefel(3, 2)
    starts = nearby(scene.rotation, 0.5)
    problem = scene.problem(lam)
    found = alternate(problem, starts, signed=signed, tolerance=0.0, max_rounds=rounds)
    for image in range(4):
        w = scene.landmarks[image] - scene.landmarks[image].mean(axis=1, keepdims=True)
        X = starts[image, 0, :2].T
        for _ in range(rounds):
            A = (X.T @ scene.atoms).reshape(len(scene.atoms), -1).T
            lasso = Lasso(
                alpha=lam / w.size, fit_intercept=False, positive=not signed, tol=1e-13,
                max_iter=1_000_000,
            )  # fmt: skip
            c = lasso.fit(A, w.ravel()).coef_
            S = np.tensordot(c, scene.atoms, axes=1)

            @pymanopt.function.numpy(manifold)
            def cost(X, S=S, w=w):
                return 0.5 * ((w - X.T @ S) ** 2).sum()

            @pymanopt.function.numpy(manifold)
            def gradient(X, S=S, w=w):
                return S @ (S.T @ X - w.T)

            @pymanopt.function.numpy(manifold)
            def hessian(_X, U, S=S):
                return S @ (S.T @ U)

            judge = pymanopt.Problem(
                manifold, cost, euclidean_gradient=gradient, euclidean_hessian=hessian
            )
            optimizer = TrustRegions(verbosity=0, min_gradient_norm=1e-10)
            X = optimizer.run(judge, initial_point=X).point
        np.testing.assert_allclose(found.coefficients[image], c, atol=1e-6)
        np.testing.assert_allclose(found.rotation[image, :2], X.T, atol=1e-6)
        assert found.rounds[image] == rounds


@signs
def test_the_convex_program_bounds_it_from_below(make_scene, rng, signed):
    scene = make_scene(n=20, k=15, noise=0.3, weighted=True, hidden=0.2)
    problem = scene.problem(0.1)
    solution = solve_newton(problem, tolerance=1e-8)
    bound = solution.objective * (1 - solution.relative_gap)
    _, objective = parts(problem, alternate(problem, nearby(scene.rotation), signed=signed))
    assert (objective >= bound * (1 - 1e-12)).all()


def test_signs_are_free_only_where_asked(make_scene):
    scene = make_scene(n=20, noise=0.3)
    bound, free = (
        alternate(scene.problem(0.1), nearby(scene.rotation), signed=signed)
        for signed in (False, True)
    )
    assert (bound.coefficients >= 0).all()
    assert (free.coefficients < 0).any()


def test_the_best_start_counts(make_scene, rng):
    scene = make_scene(n=15, k=15, noise=0.3)
    problem = scene.problem(0.1)
    starts = np.stack([random_rotations(5, rng) for _ in range(15)])
    alone = [parts(problem, alternate(problem, starts[:, [s]]))[1] for s in range(5)]
    together = alternate(problem, starts)
    np.testing.assert_allclose(parts(problem, together)[1], np.min(alone, axis=0), rtol=1e-12)
    rounds = [alternate(problem, starts[:, [s]]).rounds for s in range(5)]
    np.testing.assert_array_equal(together.rounds, np.sum(rounds, axis=0))


def test_hidden_landmarks_are_irrelevant(make_scene, rng):
    scene = make_scene(n=20, noise=0.2, weighted=True, hidden=0.3)
    garbage = np.where(scene.weights[:, None] > 0, scene.landmarks, 1e6)
    starts = nearby(scene.rotation)
    clean = alternate(scene.problem(0.1), starts)
    dirty = alternate(build_problem(garbage, scene.atoms, 0.1, weights=scene.weights), starts)
    np.testing.assert_array_equal(clean.coefficients, dirty.coefficients)
    np.testing.assert_array_equal(clean.rotation, dirty.rotation)

    seen = scene.weights[0] > 0
    cut = build_problem(
        scene.landmarks[:1, :, seen], scene.atoms[:, :, seen], 0.1, weights=scene.weights[:1, seen]
    )
    alone = alternate(cut, starts[:1])
    np.testing.assert_allclose(alone.coefficients[0], clean.coefficients[0], atol=1e-9)


def test_weights_multiply_the_residual(make_scene):
    """A landmark of weight sqrt(2) counts as two copies of weight 1."""
    scene = make_scene(n=5, noise=0.3)
    starts = nearby(scene.rotation)
    heavy = np.ones(12)
    heavy[3] = np.sqrt(2)
    weighted = alternate(
        build_problem(scene.landmarks, scene.atoms, 0.1, weights=np.tile(heavy, (5, 1))),
        starts, tolerance=1e-13,
    )  # fmt: skip
    twice = [*range(12), 3]
    copied = alternate(
        build_problem(scene.landmarks[..., twice], scene.atoms[..., twice], 0.1),
        starts, tolerance=1e-13,
    )  # fmt: skip
    np.testing.assert_allclose(weighted.coefficients, copied.coefficients, atol=1e-6)
    np.testing.assert_allclose(weighted.rotation, copied.rotation, atol=1e-6)


def test_translation_permutation_and_joint_scaling(make_scene, rng):
    scene = make_scene(n=10, noise=0.2, weighted=True)
    starts = nearby(scene.rotation)
    base = alternate(scene.problem(0.1), starts, tolerance=1e-13)
    order = rng.permutation(12)
    moved = build_problem(
        3.0 * scene.landmarks[..., order] + np.array([[5.0], [-7.0]]),
        scene.atoms[..., order],
        0.3,
        weights=scene.weights[:, order],
    )
    again = alternate(moved, starts, tolerance=1e-13)
    np.testing.assert_allclose(again.coefficients, 3 * base.coefficients, atol=1e-6)
    np.testing.assert_allclose(again.rotation, base.rotation, atol=1e-6)


def test_turns_of_camera_and_object_carry_over(make_scene, rng):
    scene = make_scene(n=10, noise=0.2)
    starts = nearby(scene.rotation)
    base = alternate(scene.problem(0.1), starts, tolerance=1e-13)
    camera = rotation_about(np.array([0.0, 0.0, 1.0]), np.array([0.8]))[0]
    thing = random_rotations(1, rng)[0]
    turned = alternate(
        build_problem(camera[:2, :2] @ scene.landmarks, thing @ scene.atoms, 0.1),
        camera @ starts @ thing.T,
        tolerance=1e-13,
    )
    np.testing.assert_allclose(turned.coefficients, base.coefficients, atol=1e-6)
    np.testing.assert_allclose(turned.rotation, camera @ base.rotation @ thing.T, atol=1e-6)


def test_a_large_lambda_gives_nothing(make_scene):
    scene = make_scene()
    found = alternate(scene.problem(1e3), nearby(scene.rotation))
    np.testing.assert_array_equal(found.coefficients, 0.0)
    assert np.isnan(found.rotation).all()
    assert set(found.status) == {Status.CONVERGED}


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


def test_threads_and_neighbours_change_nothing(make_scene):
    scene = make_scene(n=150, noise=0.2, hidden=0.1)
    problem, starts = scene.problem(0.1), nearby(scene.rotation)
    one, two = alternate(problem, starts, threads=1), alternate(problem, starts, threads=2)
    np.testing.assert_array_equal(one.coefficients, two.coefficients)
    last = build_problem(scene.landmarks[-1], scene.atoms, 0.1, weights=scene.weights[-1:])
    alone = alternate(last, starts[-1:])
    np.testing.assert_array_equal(alone.coefficients[0], one.coefficients[-1])
    np.testing.assert_array_equal(alone.rotation[0], one.rotation[-1])


def test_no_images_give_nothing(make_scene):
    scene = make_scene(n=1)
    problem = build_problem(np.zeros((0, 2, 12)), scene.atoms, 0.1)
    assert alternate(problem, np.zeros((0, 1, 3, 3))).coefficients.shape == (0, 8)


def test_what_it_cannot_do_is_said(make_scene):
    scene = make_scene()
    robust = build_problem(scene.landmarks, scene.atoms, 0.1, loss=Loss.ABSOLUTE)
    with pytest.raises(ValueError, match="squared loss only, not l1"):
        alternate(robust, nearby(scene.rotation))
    with pytest.raises(ValueError, match="starts"):
        alternate(scene.problem(0.1), scene.rotation)
    with pytest.raises(ValueError, match="starts"):
        alternate(scene.problem(0.1), np.zeros((6, 0, 3, 3)))
