"""Normalising, failing and scaling back, for any method; no shape that is not finite counts."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from shapefit.convex.solver import Status, solve_newton
from shapefit.geometry.normalisation import normalise
from shapefit.lifting.estimate import Estimate
from shapefit.lifting.lift import (
    LEAST,
    NOT_FINITE,
    Program,
    choose_lambda,
    fail_nonfinite,
    lift,
    noise_dual_norm,
)
from shapefit.lifting.methods import Settings, choose_method

PROGRAM = Program(lam=0.1)


class Flat:
    """A method whose shape is the landmarks themselves, at depth 0; remembers the problem."""

    def __init__(self, status=Status.OPTIMAL):
        self.status = status

    def __call__(self, problem):
        self.problem = problem
        n, _, p = problem.landmarks.shape
        shapes = np.concatenate([problem.landmarks, np.zeros((n, 1, p))], axis=1)
        shapes[:, :2] -= 0.25
        return Estimate(
            shapes=shapes,
            translation=np.full((n, 2), 0.25),
            rotation=np.broadcast_to(np.eye(3), (n, 3, 3)),
            objective=np.zeros(n),
            residual=np.zeros(n),
            iterations=np.zeros(n, np.int64),
            status=(self.status,) * n,
        )


@pytest.fixture
def convex():
    solve = partial(solve_newton, tolerance=1e-10, max_iterations=2000)
    return choose_method("convex", Settings(solve=solve, mean_shape=np.zeros((3, 0))))


def test_methods_see_normalised_landmarks_and_their_answer_is_scaled_back(make_scene):
    scene = make_scene(n=5)
    landmarks, flat = 37.0 * scene.landmarks + 400.0, Flat()
    found = lift(landmarks, scene.weights, scene.atoms, PROGRAM, flat)
    norm = normalise(landmarks)
    np.testing.assert_allclose(flat.problem.landmarks, norm.points, atol=1e-12)
    np.testing.assert_array_equal(flat.problem.lam, 0.1)
    np.testing.assert_allclose(found.landmarks_fitted, landmarks, rtol=1e-12)
    np.testing.assert_array_equal(found.landmarks_fitted, found.shapes[:, :2])
    np.testing.assert_array_equal(found.scale, norm.scale)
    np.testing.assert_allclose(found.translation, norm.centroid + 0.25 * norm.scale[:, None])
    assert found.failures == {}


def test_failing_images_are_named_and_leave_the_others_alone(make_scene):
    scene = make_scene(n=6)
    scene.weights[1] = 0.0
    scene.landmarks[2] = 3.0
    scene.landmarks[3, 1] = 2 * scene.landmarks[3, 0]
    scene.landmarks[4, :, 5:] = np.nan
    scene.weights[4, 5:] = 0.0
    flat = Flat()
    found = lift(scene.landmarks, scene.weights, scene.atoms, PROGRAM, flat)
    assert found.failures == {
        1: "all landmarks are hidden",
        2: "all visible landmarks are at one point",
        3: "all visible landmarks lie on one line",
    }
    for image in (1, 2, 3):
        assert np.isnan(found.shapes[image]).all()
        assert np.isnan(found.scale[image])
        np.testing.assert_array_equal(flat.problem.weights[image], 0.0)
    for image in (0, 4, 5):
        visible = scene.weights[image] > 0
        np.testing.assert_allclose(
            found.landmarks_fitted[image][:, visible],
            scene.landmarks[image][:, visible],
            rtol=1e-12,
        )


@pytest.mark.parametrize(
    ("status", "reason"),
    [
        (Status.NUMERICAL_FAILURE, "numerical failure in the solver"),
        (Status.DEGENERATE, "no pose of the mean shape fits the visible landmarks"),
    ],
)
def test_a_method_without_a_shape_is_a_failure(make_scene, status, reason):
    scene = make_scene(n=3)
    scene.weights[2] = 0.0
    found = lift(scene.landmarks, scene.weights, scene.atoms, PROGRAM, Flat(status))
    assert found.failures == {0: reason, 1: reason, 2: "all landmarks are hidden"}
    assert np.isnan(found.shapes).all()


def test_each_image_has_the_lambda_of_its_own_size_and_landmarks(make_scene):
    scene, flat = make_scene(n=3, p=16), Flat()
    landmarks = scene.landmarks * np.array([1.0, 9.0, 1.0])[:, None, None]
    weights = np.ones((3, 16))
    weights[2, 4:] = 0.0
    found = lift(landmarks, weights, scene.atoms, Program(lam=None, noise=0.2), flat)
    expected = 0.2 / found.scale * noise_dual_norm(scene.atoms) * np.array([1, 1, 0.5])
    np.testing.assert_allclose(flat.problem.lam, expected)


@pytest.mark.parametrize("visible", [np.ones(40, bool), np.arange(40) % 4 == 0])
def test_lambda_is_the_mean_dual_norm_of_the_noise_that_is_seen(rng, visible):
    """Against noise drawn anew, on the visible landmarks, about their mean; never 0."""
    atoms = rng.standard_normal((5, 3, 40))
    atoms -= atoms.mean(axis=2, keepdims=True)
    G = rng.standard_normal((4000, 1, 2, visible.sum()))
    G -= G.mean(axis=-1, keepdims=True)
    norms = np.linalg.norm(G @ atoms[..., visible].swapaxes(1, 2), "nuc", axis=(2, 3))
    program, share = Program(lam=None, noise=2.0), np.full(3, visible.mean())
    found = choose_lambda(program, atoms, np.array([1.0, 4.0, 1e9]), share)
    expected = 2.0 * norms.max(axis=1).mean() / np.array([1.0, 4.0])
    np.testing.assert_allclose(found, [*expected, LEAST], rtol=0.05)


@pytest.fixture
def lifting(make_scene):
    scene = make_scene(n=5)
    scene.weights[3] = 0.0
    settings = Settings(solve=partial(solve_newton), mean_shape=scene.mean_shape)
    method = choose_method("convex", settings)
    return lift(scene.landmarks, scene.weights, scene.atoms, Program(lam=0.1), method)


def test_what_is_finite_stays(lifting):
    assert fail_nonfinite(lifting) is lifting


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_one_coordinate_that_is_not_finite_fails_its_image(lifting, value):
    shapes = lifting.shapes.copy()
    shapes[1, 2, 4] = value
    found = fail_nonfinite(replace(lifting, shapes=shapes))
    assert found.failures == {1: NOT_FINITE, 3: "all landmarks are hidden"}
    optimal = Status.OPTIMAL
    assert found.estimate.status == (
        optimal, Status.NUMERICAL_FAILURE, optimal, Status.DEGENERATE, optimal,
    )  # fmt: skip
    for name in ("shapes", "landmarks_fitted", "translation", "scale"):
        after, before = getattr(found, name), getattr(lifting, name)
        assert np.isnan(after[1]).all()
        others = [0, 2, 3, 4]
        np.testing.assert_array_equal(after[others], before[others])
