"""One rotation: alternation, poses, synchronisation, and refinement without
outliers.
"""

from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from shapefit.convex.problem import Loss, build_problem
from shapefit.convex.solver import Status, solve_newton
from shapefit.convex.transforms import Transforms
from shapefit.geometry.rotations import random_rotations, rotation_about
from shapefit.lifting import shared_rotation
from shapefit.lifting.estimate import fit_translation
from shapefit.lifting.lift import Program, lift
from shapefit.lifting.shared_rotation import alternate, even_views, find_pose
from tests.lifting.estimators import make_estimator

signs = pytest.mark.parametrize("signed", [False, True])


def nearby(rotation, angle=0.3):
    return (
        rotation @ rotation_about(np.array([1.0, -1.0, 0.5]), np.array([angle]))[0]
    )[:, None]


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
    """From one round to the next: what fewer rounds end with is never below what more
    end with.
    """
    scene = make_scene(n=12, k=20, noise=0.3)
    problem = scene.problem(0.1)
    before = np.inf
    for rounds in (1, 2, 3, 5, 9, 17, 33):
        starts = nearby(scene.rotation, 1.0)
        found = alternate(
            problem, starts, signed=signed, tolerance=0, max_rounds=rounds
        )
        _, now = parts(problem, found)
        assert (now <= before * (1 + 1e-13)).all()
        before = now


@signs
def test_it_ends_where_neither_step_can_gain(make_scene, signed):
    """Optimal c for R (KKT), vanishing Riemannian gradient in R for c: with weights and
    T.
    """
    scene = make_scene(n=20, k=20, noise=0.2, weighted=True, hidden=0.2)
    problem = scene.problem(0.05)
    starts = nearby(scene.rotation)
    found = alternate(problem, starts, signed=signed, tolerance=0.0, max_rounds=20_000)
    c, R = found.coefficients, found.rotation
    residual, _ = parts(problem, found)
    pull = problem.weights[:, None] * residual
    assert np.abs(pull.sum(axis=2)).max() < 1e-12  # the translation is optimal
    correlation = np.einsum("nap,nab,kbp->nk", pull, R[:, :2], problem.atoms)
    if not signed:
        assert (c >= 0).all()
    assert (np.abs(correlation) if signed else correlation).max() < 0.05 * (1 + 1e-5)
    assert_allclose(correlation[c != 0], 0.05 * np.sign(c[c != 0]), rtol=1e-5)
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
    starts = nearby(scene.rotation, 0.1)
    found = alternate(problem, starts, tolerance=1e-12, max_rounds=5000)
    assert_allclose(found.coefficients, scene.coefficients, atol=1e-3)
    assert_allclose(found.rotation, scene.rotation, atol=1e-3)
    assert set(found.status) == {Status.CONVERGED}


def test_the_best_start_counts(make_scene, rng):
    scene = make_scene(n=15, k=15, noise=0.3)
    problem = scene.problem(0.1)
    starts = np.stack([random_rotations(5, rng) for _ in range(15)])
    alone = [parts(problem, alternate(problem, starts[:, [s]]))[1] for s in range(5)]
    together = alternate(problem, starts)
    assert_allclose(parts(problem, together)[1], np.min(alone, axis=0), rtol=1e-12)
    rounds = [alternate(problem, starts[:, [s]]).rounds for s in range(5)]
    assert_array_equal(together.rounds, np.sum(rounds, axis=0))


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


@pytest.fixture
def shape(rng):
    return rng.standard_normal((3, 10))


def test_an_image_whose_atoms_underflow_is_a_failure(make_scene, rng):
    problem = make_scene(n=2).problem(0.2)
    tiny = replace(problem, atoms=1e-165 * problem.atoms, lam=1e-165 * problem.lam)
    found = alternate(tiny, random_rotations(4, rng).reshape(2, 2, 3, 3))
    assert set(found.status) == {Status.NUMERICAL_FAILURE}


def posed(shape, R, size, T, noise=0.0, rng=None):
    landmarks = size[:, None, None] * R[:, :2] @ shape + T[..., None]
    return landmarks + (noise * rng.standard_normal(landmarks.shape) if noise else 0.0)


def misfits(problem, shape, pose):
    omega = problem.weights[:, None]
    left = problem.landmarks - pose.size[:, None, None] * pose.rotation[:, :2] @ shape
    T = (left * omega**2).sum(-1, keepdims=True) / (omega**2).sum(-1, keepdims=True)
    return 0.5 * (omega**2 * (left - T) ** 2).sum(axis=(1, 2))


@pytest.mark.parametrize("flat", [False, True])
def test_planted_poses_come_back(shape, rng, flat):
    if flat:  # depth reversed, a flat shape has a second pose of the same image
        shape[2] = 0.0
    R, size = random_rotations(200, rng), rng.uniform(0.2, 4, 200)
    T = rng.standard_normal((200, 2))
    problem = build_problem(posed(shape, R, size, T), shape[None], 1.0)
    found = find_pose(problem, shape)
    assert_allclose(found.size, size, rtol=1e-7)
    assert_allclose(misfits(problem, shape, found), 0.0, atol=1e-12)
    if flat:
        reversed_depth = R * np.array([1.0, 1.0, -1.0])
        reversed_depth[:, 2] *= -1
        nearest = np.minimum(
            np.abs(found.rotation - R).max(axis=(1, 2)),
            np.abs(found.rotation - reversed_depth).max(axis=(1, 2)),
        )
        assert_allclose(nearest, 0.0, atol=1e-6)
    else:
        assert_allclose(found.rotation, R, atol=1e-6)


def test_one_start_is_the_identity_turned_in_the_plane(shape):
    angle = np.linspace(-3, 3, 40)
    in_plane = rotation_about(np.array([0.0, 0.0, 1.0]), angle)
    problem = build_problem(in_plane[:, :2] @ shape, shape[None], 1.0)
    one = find_pose(problem, shape, 1)
    assert_allclose(one.rotation, in_plane, atol=1e-7)
    assert_allclose(one.size, 1, rtol=1e-7)


@pytest.fixture
def turned():
    """Mixtures of atoms seen from everywhere, and the mean of the atoms, whose pose has
    a second minimum in many of these images.
    """
    rng = np.random.default_rng(2)
    atoms = rng.standard_normal((3, 10)) + 0.5 * rng.standard_normal((4, 3, 10))
    atoms -= atoms.mean(axis=2, keepdims=True)
    shapes = np.tensordot(rng.dirichlet(np.ones(4), 200), atoms, axes=1)
    landmarks = (random_rotations(200, rng) @ shapes)[:, :2]
    return atoms.mean(axis=0), build_problem(landmarks, atoms, 0.05)


def test_more_starts_never_fit_worse(turned):
    mean_shape, problem = turned
    one, six, many = (
        misfits(problem, mean_shape, find_pose(problem, mean_shape, starts))
        for starts in (1, 6, 24)
    )
    assert (one > 2 * six).mean() > 0.1
    assert (six <= one * (1 + 1e-9)).all()
    assert (many <= one * (1 + 1e-9)).all()


@pytest.mark.parametrize("name", ["alternate", "mean-shape"])
def test_the_methods_start_from_as_many_views_as_they_are_told(name, turned):
    mean_shape, problem = turned
    settings = {"mean_shape": mean_shape}
    one, six = (
        make_estimator(name, **settings | {"starts": starts})(problem)
        for starts in (1, 6)
    )
    assert one.objective.mean() > 2 * six.objective.mean()
    pose = find_pose(problem, mean_shape, 1)
    from_it = alternate(problem, pose.rotation[:, None]).rotation
    expected = pose.rotation if name == "mean-shape" else from_it
    assert_array_equal(one.rotation, expected)
    default = make_estimator(name, **settings)(problem)
    assert_array_equal(default.rotation, six.rotation)


@pytest.mark.parametrize("count", [1, 2, 6, 24])
def test_views_are_spread_over_the_sphere(count, rng):
    views = even_views(count)
    assert_array_equal(views[0], np.eye(3))
    assert_allclose(
        views @ views.swapaxes(1, 2),
        np.broadcast_to(np.eye(3), views.shape),
        atol=1e-14,
    )
    assert_allclose(np.linalg.det(views), 1)
    axes = views[:, 2]
    directions = random_rotations(2000, rng)[:, 0]
    farthest = np.degrees(np.arccos((directions @ axes.T).max(axis=1).min()))
    assert farthest < {1: 181, 2: 136, 6: 75, 24: 38}[count]


def test_without_landmarks_there_is_no_pose(shape):
    weights = np.ones((2, 10))
    weights[0] = 0.0
    problem = build_problem(
        np.stack([shape[:2], shape[:2]]), shape[None], 1.0, weights=weights
    )
    found = find_pose(problem, shape)
    assert_array_equal(np.isnan(found.rotation).all(axis=(1, 2)), [True, False])
    assert_allclose(found.size, [0, 1], atol=1e-9)


class Synchronised(NamedTuple):
    """The rotation found, and the best c >= 0 at it."""

    rotation: np.ndarray
    coefficients: np.ndarray


def synchronise(M):
    R = shared_rotation.synchronise(Transforms.of(M))
    c = np.maximum(np.einsum("nkab,nab->nk", M, R[:, :2]), 0.0) / 2
    return Synchronised(R, np.nan_to_num(c))


@pytest.fixture
def loose(rng):
    """Return transforms around a shared rotation, far from it, with some zeros."""
    R = random_rotations(12, rng)
    M = rng.uniform(0, 2, (12, 9, 1, 1)) * (
        R[:, None, :2] + 0.7 * rng.standard_normal((12, 9, 2, 3))
    )
    M[:, 6:] = 0.0
    return M


def test_transforms_that_share_a_rotation_give_it_exactly(rng):
    R = random_rotations(20, rng)
    c = rng.uniform(0, 2, (20, 7)) * (rng.random((20, 7)) < 0.6)
    c[:, 2] = 0.5
    found = synchronise(c[..., None, None] * R[:, None, :2])
    assert_allclose(found.rotation, R, atol=1e-13)
    assert_allclose(found.coefficients, c, atol=1e-13)


def test_the_answer_is_a_stationary_point(loose):
    """sum_i c_i M_i Rbar^T is symmetric and positive semidefinite, and each c_i the
    best >= 0.
    """
    found = synchronise(loose)
    R, c = found.rotation, found.coefficients
    assert_allclose(np.linalg.norm(R, axis=2), 1, atol=1e-14)
    assert_allclose(np.linalg.det(R), 1)  # of unit rows: they are orthogonal
    inner = np.einsum("nkab,nab->nk", loose, R[:, :2]) / 2
    assert_allclose(c, np.maximum(inner, 0), atol=1e-14)
    X = np.einsum("nk,nkab,ncb->nac", c, loose, R[:, :2])
    assert_allclose(X, X.swapaxes(1, 2), atol=1e-9)
    assert np.linalg.eigvalsh(X).min() > 0


def test_the_largest_transform_may_win_against_the_sum(rng):
    """Two smaller transforms outvote a large one in the sum, but not in the squares."""
    R = random_rotations(1, rng)
    M = np.array([1.0, -0.6, -0.6])[:, None, None] * R[:, None, :2]
    found = synchronise(M)
    assert_allclose(found.rotation, R, atol=1e-12)
    assert_allclose(found.coefficients, [[1.0, 0.0, 0.0]], atol=1e-12)


@pytest.mark.parametrize("nothing", [0.0, np.nan])
def test_without_transforms_there_is_no_rotation(loose, nothing):
    loose[3] = nothing
    found = synchronise(loose)
    assert np.isnan(found.rotation[3]).all()
    assert_array_equal(found.coefficients[3], 0.0)
    assert np.isfinite(np.delete(found.rotation, 3, axis=0)).all()


ROBUST = (Loss.ABSOLUTE, Loss.SPARSE_ERROR)


@pytest.fixture
def scene(make_scene):
    return make_scene(n=20, k=6, p=40, active=2)


@pytest.fixture
def settings(scene):
    return {
        "solve": partial(solve_newton, tolerance=1e-6),
        "mean_shape": scene.mean_shape,
    }


@pytest.fixture
def corrupted(scene, rng):
    """A problem with every fifth landmark of each image elsewhere, and which those
    are.
    """
    wrong = rng.random((20, 40)).argsort(axis=1) < 8
    move = np.where(wrong[:, None], rng.choice([-1, 1], (20, 2, 40)) * 2.0, 0.0)
    return replace(scene, landmarks=scene.landmarks + move).problem(0.02), wrong


@pytest.mark.parametrize("loss", ROBUST)
def test_planted_outliers_are_labelled_and_left_out(loss, corrupted, settings):
    problem, wrong = corrupted
    robust = make_estimator("convex+refine", **settings)(
        replace(problem, loss=loss, beta=0.1)
    )
    assert set(robust.status) == {Status.CONVERGED}
    assert robust.relative_gap is None
    assert robust.outliers[wrong].all()
    labels = make_estimator("convex", **settings)(
        replace(problem, loss=loss, beta=0.1)
    ).outliers
    assert_array_equal(robust.outliers, labels)

    garbage = np.where(wrong[:, None], 1e6, problem.landmarks)
    inliers = replace(
        problem,
        landmarks=garbage,
        weights=np.where(robust.outliers, 0.0, problem.weights),
    )
    alone = make_estimator("convex+refine", **settings)(inliers)
    assert_allclose(robust.objective, alone.objective, rtol=1e-3)
    assert (robust.residual < 0.05).all()


def test_labels_that_leave_too_little_are_not_believed(scene, settings):
    """With a beta so small that every landmark is an outlier of the convex program."""
    program = Program(0.02, Loss.SPARSE_ERROR, beta=1e-9)
    method = make_estimator("convex+refine", **settings)
    found = lift(scene.landmarks, scene.weights, scene.atoms, program, method)
    assert found.failures == {}
    assert np.isfinite(found.shapes).all()
    assert not found.estimate.outliers.any()
