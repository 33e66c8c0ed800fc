"""Truncated least squares: weights in closed form, planted outliers, units, degenerate images."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from shapefit.convex.newton import solve_newton
from shapefit.convex.problem import build_problem
from shapefit.convex.transforms import Transforms
from shapefit.core import STRETCH
from shapefit.geometry.normalisation import normalise, spread
from shapefit.geometry.rotations import random_rotations
from shapefit.lifting.outliers import truncated
from shapefit.lifting.outliers.truncated import (
    find_untruncated,
    first_mu,
    residual_squares,
    share_of,
    weigh,
)
from shapefit.lifting.reconstruction import reconstruct

P = 40
SOLVE = partial(solve_newton, tolerance=1e-6)


@pytest.fixture
def scene(make_scene):
    scene = make_scene(n=12, k=5, p=P, active=2)
    size = normalise(scene.atoms).scale[:, None, None]
    return replace(scene, atoms=scene.atoms / size)


def plant(landmarks, share, rng):
    """Move a share of the landmarks by about the size of the object, none by less."""
    wrong = rng.random((len(landmarks), P)).argsort(1) < round(share * P)
    angle = rng.uniform(0, 2 * np.pi, wrong.shape)
    size = normalise(landmarks).scale[:, None]
    move = size * rng.uniform(1.5, 3, wrong.shape) * np.stack([np.cos(angle), np.sin(angle)])
    return np.where(wrong[:, None], landmarks + move.swapaxes(0, 1), landmarks), wrong


def search(landmarks, atoms, weights=None, solve=SOLVE, **settings):
    weights = np.ones((len(landmarks), P)) if weights is None else weights
    settings = {"lam": 1.0, "threshold": 0.3, "max_rounds": 100} | settings
    return find_untruncated(landmarks, weights, atoms, solve, **settings)


@pytest.mark.parametrize("share", [0.0, 0.3, 0.4])
def test_planted_outliers_are_found_exactly(scene, share, rng):
    landmarks, wrong = plant(scene.landmarks, share, rng)
    np.testing.assert_array_equal(search(landmarks, scene.atoms), ~wrong)


def test_half_of_the_landmarks_of_one_rigid_shape(scene, rng):
    landmarks, wrong = plant(scene.rotation[:, :2] @ scene.atoms[0], 0.5, rng)
    np.testing.assert_array_equal(search(landmarks, scene.atoms[:1]), ~wrong)


def test_the_slow_schedule_finds_what_a_fast_one_does_not(rng, monkeypatch):
    """More than half of the landmarks of a rigid shape wrong, among three atoms that could bend."""
    n, share = 40, 0.55
    atoms = normalise(rng.standard_normal((3, 3, P))).points
    landmarks = random_rotations(n, rng)[:, :2] @ atoms[0]
    wrong = rng.random((n, P)).argsort(1) < round(share * P)
    low, high = landmarks.min(axis=2, keepdims=True), landmarks.max(axis=2, keepdims=True)
    points = rng.uniform(low, high, landmarks.shape)
    near = np.linalg.norm(points - landmarks, axis=1, keepdims=True) < 0.5
    points = np.where(near, landmarks + 0.7, points)
    landmarks = np.where(wrong[:, None], points, landmarks)

    def found():
        return (search(landmarks, atoms) == ~wrong).all(axis=1).mean()

    assert found() > 0.9
    monkeypatch.setattr(truncated, "GROWTH", 10.0)
    assert found() < 0.6


@pytest.mark.parametrize("mu", [1e-3, 0.3, 5.0])
def test_the_shares_minimise_the_surrogate(mu):
    """The minimum of w q + mu (1 - w) / (mu + w) over a fine grid of w in 0..1."""
    w = np.linspace(0, 1, 200_001)
    square = np.concatenate([np.linspace(0, 3, 40), np.linspace(3, 2 / mu + 2, 40)])
    found = share_of(square[None], np.array([mu]))[0]
    for q, share in zip(square, found, strict=True):
        assert share == pytest.approx(w[np.argmin(w * q + mu * (1 - w) / (mu + w))], abs=1e-5)


def test_an_infinite_mu_is_the_truncated_square_itself():
    found = share_of(np.array([[0.0, 0.9, 1.0, 1.1, np.inf]]), np.array([np.inf]))
    np.testing.assert_array_equal(found, [[1, 1, 1, 0, 0]])


def test_at_the_first_mu_every_landmark_counts(rng):
    square = rng.uniform(0, 50, (20, 9))
    assert (share_of(square, first_mu(square)) > 0).all()
    assert first_mu(np.array([[0.1, 0.4]])) == np.inf


def test_the_first_and_the_last_landmark_count_as_much_as_their_shares(scene, rng):
    """The centre and size of the weighted landmarks, and lambda beside the data, stay."""
    share = rng.uniform(0.1, 1, (12, P))
    problem = weigh(scene.landmarks, np.ones((12, P)), share, scene.atoms, 0.7)
    portion = share / share.sum(axis=1, keepdims=True)
    mean = (problem.landmarks * portion[:, None]).sum(axis=2)
    deviation = np.sqrt((problem.landmarks**2 * portion[:, None]).sum(axis=2))
    np.testing.assert_allclose(mean, 0, atol=1e-12)
    np.testing.assert_allclose(deviation.mean(axis=1), 1)
    np.testing.assert_allclose(problem.weights**2, share)
    np.testing.assert_allclose(problem.lam, 0.7 * share.mean(axis=1))


def test_residuals_know_neither_the_shrinkage_nor_the_unit(scene, rng):
    landmarks = scene.landmarks + 0.1 * rng.standard_normal(scene.landmarks.shape)
    weights = rng.uniform(0.5, 1, (12, P))
    problem = build_problem(landmarks, scene.atoms, 0.5, weights=weights)
    solution = SOLVE(problem)
    base = residual_squares(problem, solution)
    shrunk = replace(solution, transforms=Transforms.of(0.2 * solution.transforms.dense()))
    np.testing.assert_allclose(residual_squares(problem, shrunk), base, rtol=1e-9)
    moved = build_problem(9 * landmarks + 5, scene.atoms, 0.5, weights=weights)
    np.testing.assert_allclose(residual_squares(moved, solution), base, rtol=1e-9)
    nothing = replace(solution, transforms=Transforms.of(0 * solution.transforms.dense()))
    assert (residual_squares(problem, nothing) == np.inf).all()


def test_hidden_garbage_a_similarity_and_threads_change_no_label(scene, rng):
    landmarks, wrong = plant(scene.landmarks, 0.3, rng)
    landmarks += 0.02 * rng.standard_normal(landmarks.shape)
    weights = (rng.random((12, P)) > 0.2).astype(float)
    base = search(landmarks, scene.atoms, weights)
    np.testing.assert_array_equal(base, ~wrong & (weights > 0))
    turn = np.array([[0.6, -0.8], [0.8, 0.6]])
    moved = 50 * turn @ landmarks + np.array([[700.0], [-9.0]])
    moved = np.where((weights > 0)[:, None], moved, np.nan)
    np.testing.assert_array_equal(search(moved, scene.atoms, weights), base)
    one = search(landmarks, scene.atoms, weights, partial(SOLVE, threads=1))
    np.testing.assert_array_equal(one, base)


def test_degenerate_images_have_no_inliers(scene):
    landmarks, weights = scene.landmarks[:4].copy(), np.ones((4, P))
    weights[0, 3:] = 0.0
    landmarks[1] = 7.0
    weights[2] = 0.0
    found = search(landmarks, scene.atoms, weights)
    assert not found[:3].any()
    assert found[3].all()


def test_where_no_shape_is_found_nothing_is_an_inlier(scene):
    assert not search(scene.landmarks, scene.atoms, lam=1e4).any()


def test_results_depend_neither_on_how_images_are_divided_nor_on_threads(make_scene, rng):
    """With a loose solver, whose answers depend on where it starts."""
    scene = make_scene(n=193, k=5, p=P, active=2, noise=0.3)
    landmarks, _ = plant(scene.landmarks, 0.4, rng)
    together = []

    def solve(problem):
        together.append(len(problem.landmarks))
        return solve_newton(problem, tolerance=0.1)

    settings = {"solve": solve, "threshold": 0.2}
    whole = search(landmarks, scene.atoms, threads=1, **settings)
    np.testing.assert_array_equal(search(landmarks, scene.atoms, threads=2, **settings), whole)
    for size in (64, 128):
        starts = range(0, len(landmarks), size)
        parts = [search(landmarks[at : at + size], scene.atoms, **settings) for at in starts]
        np.testing.assert_array_equal(np.concatenate(parts), whole)
    # the images left of several stretches would start from others than those of one
    assert max(together) == STRETCH


def test_four_landmarks_that_agree_are_enough(scene):
    """BEYOND_CHANCE is the least number that is believed."""
    weights = np.zeros((12, P))
    weights[:, [3, 11, 20, 32]] = 1.0
    found = search(scene.landmarks, scene.atoms, weights, lam=0.01)
    np.testing.assert_array_equal(found, weights > 0)


def test_residuals_are_those_of_weighted_least_squares_over_size_and_place(scene, rng):
    landmarks = scene.landmarks + 0.3 * rng.standard_normal(scene.landmarks.shape)
    weights = rng.uniform(0.1, 2, (12, P)) * (rng.random((12, P)) > 0.2)
    problem = build_problem(landmarks, scene.atoms, 0.5, weights=weights)
    solution = SOLVE(problem)
    S = reconstruct(solution.transforms, scene.atoms).shapes
    one, zero = np.ones(P), np.zeros(P)
    for image, found in enumerate(residual_squares(problem, solution)):
        A = np.stack([S[image, :2].ravel(), np.r_[one, zero], np.r_[zero, one]], axis=1)
        w, omega = problem.landmarks[image].ravel(), np.tile(weights[image], 2)
        best = np.linalg.lstsq(omega[:, None] * A, omega * w)[0]
        left = ((w - A @ best).reshape(2, P) ** 2).sum(axis=0)
        np.testing.assert_allclose(found, left / (best[0] * spread(S[image])) ** 2, rtol=1e-8)
