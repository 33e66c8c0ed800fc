"""Matching pursuit: optimal inner steps, falling errors, planted shapes, its rules,
real motion.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from shapefit.convex.problem import build_problem
from shapefit.convex.solver import Status
from shapefit.geometry.normalisation import normalise
from shapefit.geometry.procrustes import similarity_transform
from shapefit.geometry.rotations import random_rotations
from shapefit.lifting import matching_pursuit
from shapefit.lifting.lift import Program, lift
from shapefit.lifting.matching_pursuit import (
    Pursuit,
    lift_by_pursuit,
    minimise_on_sphere,
    pursue,
)

P, RADIUS = 12, 1.7


@dataclass(frozen=True)
class Scene:
    """landmarks = R_bar s (mean + sum_i c_i B_i) + T 1^T + noise, with c_i of either
    sign.
    """

    landmarks: np.ndarray
    weights: np.ndarray
    mean: np.ndarray
    bases: np.ndarray
    shapes: np.ndarray
    edges: np.ndarray

    @property
    def problem(self):
        return build_problem(self.landmarks, self.bases, 1.0, weights=self.weights)

    def pursue(self, **keys) -> Pursuit:
        return pursue(self.problem, self.mean, self.edges, **keys)

    def estimate(self):
        return method(self.mean, self.edges)(self.problem)

    def mix(self, found: Pursuit) -> np.ndarray:
        mixed = np.einsum("nk,kap->nap", found.coefficients, self.bases)
        return found.mean_coefficient[:, None, None] * self.mean + mixed


def method(mean, edges):
    return partial(lift_by_pursuit, mean_shape=mean, edges=edges)


@pytest.fixture
def make_scene(rng: np.random.Generator) -> Callable[..., Scene]:
    def make(n=5, k=9, *, active=3, noise=0.0, hidden=0.0, weighted=False) -> Scene:
        mean = normalise(rng.standard_normal((3, P))).points
        bases = rng.standard_normal((k, 3, P))
        bases -= bases.mean(axis=2, keepdims=True)
        bases /= np.linalg.norm(bases, axis=(1, 2), keepdims=True)
        coefficients = np.zeros((n, k))
        for image in range(n):
            coefficients[image, rng.choice(k, active, replace=False)] = rng.choice(
                [-2, 2], active
            )
        shapes = mean + np.einsum("nk,kap->nap", coefficients, bases)
        shapes = rng.uniform(0.5, 2, (n, 1, 1)) * (random_rotations(n, rng) @ shapes)
        landmarks = shapes[:, :2] + rng.standard_normal((n, 2, 1))
        landmarks += noise * rng.standard_normal(landmarks.shape)
        weights = rng.uniform(0.3, 2, (n, P)) if weighted else np.ones((n, P))
        weights *= rng.random((n, P)) >= hidden
        edges = np.array([[(j - 1) // 2, j] for j in range(1, P)])  # a binary tree
        return Scene(landmarks, weights, mean, bases, shapes, edges)

    return make


@pytest.fixture
def noisy(make_scene) -> Scene:
    return make_scene(noise=0.3, hidden=0.2, weighted=True)


def centred(weights: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Points (..., p) less their weighted mean, times the weights."""
    mean = np.average(points, axis=-1, weights=weights**2)[..., None]
    return weights * (points - mean)


def camera_of(found: Pursuit) -> np.ndarray:
    return found.scale[:, :, None] * found.rotation[:, :2]


class TestPursuit:
    def test_where_a_loop_comes_to_rest_both_steps_are_optimal(self, noisy):
        """c is stationary on its constraint, whose multiplier is 0; the scales are the
        least squares ones, and the rotation fits as well as the nearest to the best M.
        """
        found = noisy.pursue(goal=0.0, change=1e-16, most_atoms=4, most_rounds=20_000)
        assert (np.count_nonzero(found.coefficients, axis=1) == 4).all()
        limbs = noisy.mean[:, noisy.edges[:, 0]] - noisy.mean[:, noisy.edges[:, 1]]
        for image, S in enumerate(noisy.mix(found)):
            chosen = np.flatnonzero(found.coefficients[image])
            shapes = np.concatenate([noisy.mean[None], noisy.bases[chosen]])
            weights, M = noisy.weights[image], camera_of(found)[image]
            w, X = centred(weights, noisy.problem.landmarks[image]), centred(weights, S)
            rows = found.rotation[image, :2] @ X
            extent = (rows**2).sum(axis=1)
            overlap = (rows * w).sum(axis=1)
            assert_allclose(found.scale[image] * extent, overlap, atol=1e-9)
            assert found.error[image] == pytest.approx(
                np.linalg.norm(w - M @ X) ** 2, rel=1e-10
            )
            U, _, Vt = np.linalg.svd(w @ np.linalg.pinv(X), full_matrices=False)
            rows = U @ Vt @ X
            scale = (rows * w).sum(axis=1) / (rows**2).sum(axis=1)
            nearest = np.linalg.norm(w - scale[:, None] * rows) ** 2
            assert found.error[image] <= nearest + 1e-9
            slope = ((M @ centred(weights, shapes)) * (w - M @ X)).sum(axis=(1, 2))
            assert_allclose(slope, 0, atol=1e-6)
            lengths = S[:, noisy.edges[:, 0]] - S[:, noisy.edges[:, 1]]
            assert (lengths**2).sum() == pytest.approx((limbs**2).sum(), rel=1e-10)

    @pytest.mark.parametrize("most_rounds", [1, 30])
    def test_no_atom_raises_the_error(self, noisy, most_rounds):
        errors = [
            noisy.pursue(goal=0.0, most_atoms=most, most_rounds=most_rounds).error
            for most in range(7)
        ]
        assert (np.diff(errors, axis=0) <= 1e-12).all()
        assert (errors[-1] < 0.5 * errors[0]).all()

    @pytest.mark.parametrize("keys", [{}, {"hidden": 0.15, "weighted": True}])
    def test_mixtures_of_the_mean_and_few_bases_are_recovered(self, make_scene, keys):
        scene = make_scene(n=6, k=6, active=2, **keys)
        found = scene.pursue(goal=1e-22, change=1e-24, most_rounds=20_000)
        S = scene.mix(found)
        moved = similarity_transform(S, scene.shapes).apply(S)
        assert_allclose(moved, scene.shapes, atol=1e-6)
        relative = np.abs(found.coefficients / found.mean_coefficient[:, None])
        assert_allclose(np.sort(relative)[:, -2:], 2, atol=1e-5)
        assert_allclose(np.sort(relative)[:, :-2], 0, atol=1e-5)

    def test_the_mean_shape_needs_no_atom(self, make_scene):
        found = make_scene(active=0).pursue(goal=1e-12)
        assert not found.coefficients.any()
        assert_allclose(found.mean_coefficient, 1, rtol=1e-14)
        assert (found.rounds == 0).all()
        assert set(found.status) == {Status.CONVERGED}

    def test_the_camera_rotates_and_scales_but_does_not_shear(self, make_scene):
        """As it is stated, not any 2x3 matrix, which would fit a sheared image."""
        scene = make_scene(active=0)
        shear = np.array([[1.0, 0.5], [0.0, 1.0]])
        found = replace(scene, landmarks=shear @ scene.landmarks).pursue(most_atoms=0)
        assert (found.error > 0.1).all()
        R = found.rotation
        assert_allclose(
            R @ R.swapaxes(1, 2), np.broadcast_to(np.eye(3), R.shape), atol=1e-12
        )
        assert_allclose(np.linalg.det(R), 1)
        assert (found.scale > 0).all()

    def test_an_image_converges_at_the_goal(self, noisy):
        goal = float(np.median(noisy.pursue(goal=0.0, most_atoms=2).error))
        found = noisy.pursue(goal=goal, most_atoms=2)
        met = found.error <= goal
        assert 0 < met.sum() < 5
        wanted = [Status.CONVERGED if done else Status.ITERATION_LIMIT for done in met]
        assert list(found.status) == wanted
        assert (np.count_nonzero(found.coefficients, axis=1)[~met] == 2).all()

    def test_a_loop_ends_where_the_error_rests(self, noisy):
        rounds = [
            noisy.pursue(goal=0.0, change=change, most_atoms=1, most_rounds=500).rounds
            for change in (1e3, 1e-3, 1e-9)
        ]
        assert_array_equal(rounds[0], 1)
        assert (rounds[0] < rounds[1]).all()
        assert (rounds[1] < rounds[2]).all()
        assert_array_equal(noisy.pursue(goal=0.0, change=0.0, most_atoms=2).rounds, 60)

    def test_atoms_that_depend_on_the_chosen_ones_are_passed_over(self, noisy):
        bases = np.concatenate([noisy.bases, -noisy.bases, noisy.mean[None]])
        expected = noisy.pursue(goal=0.0, most_atoms=9)
        found = replace(noisy, bases=bases).pursue(goal=0.0, most_atoms=15)
        assert_allclose(found.coefficients[:, :9], expected.coefficients, atol=1e-8)
        assert not found.coefficients[:, 9:].any()
        assert set(found.status) == {Status.ITERATION_LIMIT}

    @pytest.mark.parametrize("visible", [2, 3, 4])
    def test_few_landmarks_leave_a_camera(self, make_scene, visible):
        scene = make_scene(noise=0.3)
        scene.weights[:, visible:] = 0
        found = scene.pursue(goal=0.0)
        assert np.isfinite(camera_of(found)).all()
        assert (found.error < (scene.landmarks[..., :visible] ** 2).sum()).all()
        if visible == 2:
            assert_allclose(found.error, 0, atol=1e-10)

    def test_it_does_not_matter_which_images_are_pursued_together(
        self, make_scene, monkeypatch
    ):
        scene = make_scene(n=40, noise=0.3)
        together = scene.pursue(most_atoms=4)
        monkeypatch.setattr(matching_pursuit, "IMAGES_PURSUED_AT_ONCE", 7)
        apart = scene.pursue(most_atoms=4)
        for one, other in zip(together, apart, strict=True):
            assert_array_equal(one, other)

    def test_images_that_cannot_be_pursued_leave_the_others_alone(self, make_scene):
        scene = make_scene()
        expected = scene.pursue()
        scene.weights[1] = 0
        scene.weights[3, 1:] = 0
        scene.weights[2] = 1e200
        found = scene.pursue()
        assert [found.status[i] for i in (1, 3)] == [Status.DEGENERATE] * 2
        assert found.status[2] is Status.NUMERICAL_FAILURE
        assert np.isnan(found.rotation[1:4]).all()
        assert np.isnan(found.scale[1:4]).all()
        assert_array_equal(found.coefficients[::4], expected.coefficients[::4])


class TestEstimate:
    def test_the_scales_of_the_camera_become_one(self, noisy):
        pursuit, found = noisy.pursue(), noisy.estimate()
        assert_array_equal(found.rotation, pursuit.rotation)
        for image, s in enumerate(pursuit.scale):
            S = s.mean() * found.rotation[image] @ noisy.mix(pursuit)[image]
            assert_allclose(found.shapes[image], S, atol=1e-12)
            relative = found.coefficients[image] / s.mean()
            assert_allclose(relative, pursuit.coefficients[image], atol=1e-12)
        assert_allclose(np.linalg.det(found.rotation), 1)

    def test_lifted_shapes_lie_where_the_true_ones_do(self, make_scene):
        """The mean shape, turned, in pixels, with hidden landmarks: no atom is
        needed.
        """
        scene = make_scene(active=0, hidden=0.2)
        shapes = 40 * scene.shapes
        shapes[:, :2] += 300
        estimator = method(scene.mean, scene.edges)
        found = lift(
            shapes[:, :2], scene.weights, scene.bases, Program(lam=0.1), estimator
        )
        assert not found.failures
        assert_allclose(found.shapes, shapes, atol=1e-9)


def minimiser(G, g, radius=RADIUS, before=None):
    y = np.ones(len(g)) if before is None else np.array(before, dtype=float)
    return minimise_on_sphere(np.array([G]), np.array([g]), radius, y[None])[0]


class TestSphere:
    """Least squares on a sphere: the optimality conditions, the hard case."""

    @pytest.mark.parametrize("m", [1, 2, 5, 16])
    @pytest.mark.parametrize("radius", [1e-3, 1.0, 1e3])
    @pytest.mark.parametrize("rank", [3, 16])
    def test_it_meets_the_optimality_conditions(self, rng, m, radius, rank):
        """Stationary, on the sphere, and the Hessian of the Lagrangian positive
        semidefinite.
        """
        for _ in range(20):
            A = rng.standard_normal((min(rank, m), m))
            G, g = A.T @ A, A.T @ rng.standard_normal(len(A))
            y = minimiser(G, g, radius)
            size = np.linalg.norm(G, 2) + np.linalg.norm(g) / radius
            multiplier = (g - G @ y) @ y / radius**2
            assert np.linalg.norm(y) == pytest.approx(radius, rel=1e-14)
            assert np.linalg.norm(G @ y + multiplier * y - g) <= 1e-12 * size * radius
            assert np.linalg.eigvalsh(G)[0] + multiplier >= -1e-13 * size

    @pytest.mark.parametrize("side", [-1, 1])
    def test_of_two_minimisers_the_nearer_is_taken(self, side):
        """g has no part along the least eigenvalue but rounding: the eigenvector fills
        up y.
        """
        G, g = 1e8 * np.diag([1.0, 3.0, 4.0]), 1e8 * np.array([1e-17, 2.0, 0.0])
        y = minimiser(G, g, before=[side, 0.1, 0.2])
        assert_allclose(y, [side * np.sqrt(RADIUS**2 - 1), 1, 0], atol=1e-14)
