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
from scipy.optimize import nnls

from shapefit.convex.problem import build_problem
from shapefit.convex.solver import Status
from shapefit.geometry.normalisation import normalise
from shapefit.geometry.procrustes import similarity_transform
from shapefit.geometry.rotations import random_rotations
from shapefit.lifting import matching_pursuit
from shapefit.lifting.lift import Program, lift
from shapefit.lifting.matching_pursuit import (
    Pursuit,
    fit_scales,
    lift_by_pursuit,
    minimise_on_sphere,
    pursue,
)
from tests.points import (
    assert_rotations,
    binary_tree,
    centred,
    edge_lengths,
    mix,
    resized,
    unit_norm,
    with_noise,
)

P = 12
"""Landmarks."""


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
        """Return the shapes (n, 3, p) that a pursuit has found, before they turn."""
        mean_part = found.mean_coefficient[:, None, None] * self.mean
        return mean_part + mix(found.coefficients, self.bases)


def method(mean, edges):
    return partial(lift_by_pursuit, mean_shape=mean, edges=edges)


@pytest.fixture
def make_scene(rng: np.random.Generator) -> Callable[..., Scene]:
    def make(n=5, k=9, *, active=3, noise=0.0, hidden=0.0, weighted=False) -> Scene:
        mean = normalise(rng.standard_normal((3, P))).points
        bases = unit_norm(centred(rng.standard_normal((k, 3, P))))
        coefficients = np.zeros((n, k))
        for image in range(n):
            used = rng.choice(k, active, replace=False)
            coefficients[image, used] = rng.choice([-2, 2], active)
        shapes = mean + mix(coefficients, bases)
        size = rng.uniform(0.5, 2, (n, 1, 1))
        shapes = size * (random_rotations(n, rng) @ shapes)

        landmarks = shapes[:, :2] + rng.standard_normal((n, 2, 1))
        landmarks = with_noise(landmarks, noise, rng)
        weights = rng.uniform(0.3, 2, (n, P)) if weighted else np.ones((n, P))
        weights *= rng.random((n, P)) >= hidden
        return Scene(landmarks, weights, mean, bases, shapes, binary_tree(P))

    return make


@pytest.fixture
def noisy(make_scene) -> Scene:
    return make_scene(noise=0.3, hidden=0.2, weighted=True)


def weigh(weights: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Points (..., p) less their weighted mean, times the weights."""
    mean = np.average(points, axis=-1, weights=weights**2)[..., None]
    return weights * (points - mean)


def camera_of(found: Pursuit) -> np.ndarray:
    """Return the camera M (n, 2, 3) of each image: a scale for each row of R."""
    return found.scale[:, :, None] * found.rotation[:, :2]


def scales_by_least_squares(rows: np.ndarray, w: np.ndarray) -> np.ndarray:
    """Return the best scale (2,) of each row of points (2, p)."""
    return (rows * w).sum(axis=1) / (rows**2).sum(axis=1)


def sum_of_squared_lengths(shapes: np.ndarray, edges: np.ndarray) -> np.ndarray:
    return (edge_lengths(shapes, edges) ** 2).sum(axis=1)


@dataclass(frozen=True)
class RestingImage:
    """An image of a pursuit that has come to rest: w ~ M X, both weighted, with M = s R
    and X a mixture of shapes.
    """

    w: np.ndarray
    X: np.ndarray
    M: np.ndarray
    R: np.ndarray
    scale: np.ndarray
    error: float
    shapes: np.ndarray

    @property
    def residual(self) -> np.ndarray:
        return self.w - self.M @ self.X


class TestRest:
    """Where a loop comes to rest both of its steps are optimal."""

    @pytest.fixture
    def found(self, noisy):
        return noisy.pursue(goal=0.0, change=1e-16, max_atoms=4, max_rounds=20_000)

    @pytest.fixture
    def images(self, noisy, found):
        images = []
        for image, S in enumerate(noisy.mix(found)):
            weights = noisy.weights[image]
            chosen = np.flatnonzero(found.coefficients[image])
            shapes = np.concatenate([noisy.mean[None], noisy.bases[chosen]])
            images.append(
                RestingImage(
                    w=weigh(weights, noisy.problem.landmarks[image]),
                    X=weigh(weights, S),
                    M=camera_of(found)[image],
                    R=found.rotation[image],
                    scale=found.scale[image],
                    error=found.error[image],
                    shapes=weigh(weights, shapes),
                )
            )
        return images

    def test_it_has_as_many_atoms_as_it_may(self, found):
        count = np.count_nonzero(found.coefficients, axis=1)
        assert (count == 4).all()

    def test_the_error_is_that_of_its_shape_and_camera(self, images):
        for image in images:
            expected = np.linalg.norm(image.residual) ** 2
            assert image.error == pytest.approx(expected, rel=1e-10)

    def test_scales_are_those_of_least_squares(self, images):
        for image in images:
            rows = image.R[:2] @ image.X
            expected = scales_by_least_squares(rows, image.w)
            assert_allclose(image.scale, expected, atol=1e-9)

    def test_no_camera_nearest_to_the_best_matrix_fits_better(self, images):
        for image in images:
            best = image.w @ np.linalg.pinv(image.X)
            U, _, Vt = np.linalg.svd(best, full_matrices=False)
            rows = U @ Vt @ image.X
            scale = scales_by_least_squares(rows, image.w)
            error = np.linalg.norm(image.w - scale[:, None] * rows) ** 2
            assert image.error <= error + 1e-9

    def test_coefficients_are_stationary_with_the_multiplier_0(self, images):
        for image in images:
            seen = image.M @ image.shapes
            slope = (seen * image.residual).sum(axis=(1, 2))
            assert_allclose(slope, 0, atol=1e-6)

    def test_lengths_are_those_of_the_mean_shape(self, noisy, found):
        lengths = sum_of_squared_lengths(noisy.mix(found), noisy.edges)
        (expected,) = sum_of_squared_lengths(noisy.mean[None], noisy.edges)
        assert lengths == pytest.approx(expected, rel=1e-10)


class TestPursuit:
    @pytest.mark.parametrize("max_rounds", [1, 30])
    def test_no_atom_raises_the_error(self, noisy, max_rounds):
        keys = {"goal": 0.0, "max_rounds": max_rounds}
        errors = [noisy.pursue(max_atoms=most, **keys).error for most in range(7)]
        assert (np.diff(errors, axis=0) <= 1e-12).all()
        assert (errors[-1] < 0.5 * errors[0]).all()

    @pytest.mark.parametrize("keys", [{}, {"hidden": 0.15, "weighted": True}])
    def test_mixtures_of_the_mean_and_few_bases_are_recovered(self, make_scene, keys):
        """Of six bases two have the coefficient 2 or -2."""
        scene = make_scene(n=6, k=6, active=2, **keys)

        found = scene.pursue(goal=1e-22, change=1e-24, max_rounds=20_000)

        shapes = scene.mix(found)
        moved = similarity_transform(shapes, scene.shapes).apply(shapes)
        assert_allclose(moved, scene.shapes, atol=1e-6)
        relative = found.coefficients / found.mean_coefficient[:, None]
        ordered = np.sort(np.abs(relative))
        assert_allclose(ordered[:, -2:], 2, atol=1e-5)
        assert_allclose(ordered[:, :-2], 0, atol=1e-5)

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
        sheared = replace(scene, landmarks=shear @ scene.landmarks)

        found = sheared.pursue(max_atoms=0)

        assert (found.error > 0.1).all()
        assert_rotations(found.rotation)
        assert (found.scale > 0).all()

    def test_an_image_converges_at_the_goal(self, noisy):
        goal = np.median(noisy.pursue(goal=0.0, max_atoms=2).error)

        found = noisy.pursue(goal=float(goal), max_atoms=2)

        is_met = found.error <= goal
        assert 0 < is_met.sum() < 5
        has_converged = [status is Status.CONVERGED for status in found.status]
        assert has_converged == is_met.tolist()
        assert {*found.status} == {Status.CONVERGED, Status.ITERATION_LIMIT}
        count = np.count_nonzero(found.coefficients, axis=1)
        assert (count[~is_met] == 2).all()

    def test_a_loop_ends_where_the_error_rests(self, noisy):
        """The less change counts as rest, the more rounds there are."""

        def rounds_until(change):
            keys = {"goal": 0.0, "max_atoms": 1, "max_rounds": 500}
            return noisy.pursue(change=change, **keys).rounds

        at_once = rounds_until(1e3)
        early = rounds_until(1e-3)
        late = rounds_until(1e-9)

        assert_array_equal(at_once, 1)
        assert (at_once < early).all()
        assert (early < late).all()

    def test_a_loop_that_does_not_rest_ends_after_30_rounds(self, noisy):
        found = noisy.pursue(goal=0.0, change=0.0, max_atoms=2)
        assert_array_equal(found.rounds, 2 * 30)

    def test_atoms_that_depend_on_the_chosen_ones_are_passed_over(self, noisy):
        bases = np.concatenate([noisy.bases, -noisy.bases, noisy.mean[None]])
        expected = noisy.pursue(goal=0.0, max_atoms=9)

        found = replace(noisy, bases=bases).pursue(goal=0.0, max_atoms=15)

        assert_allclose(found.coefficients[:, :9], expected.coefficients, atol=1e-8)
        assert not found.coefficients[:, 9:].any()
        assert set(found.status) == {Status.ITERATION_LIMIT}

    @pytest.mark.parametrize("visible", [2, 3, 4])
    def test_few_landmarks_leave_a_camera(self, make_scene, visible):
        scene = make_scene(noise=0.3)
        scene.weights[:, visible:] = 0

        found = scene.pursue(goal=0.0)

        whole = (scene.landmarks[..., :visible] ** 2).sum()
        assert np.isfinite(camera_of(found)).all()
        assert (found.error < whole).all()

    def test_two_landmarks_are_fitted_exactly(self, make_scene):
        scene = make_scene(noise=0.3)
        scene.weights[:, 2:] = 0
        found = scene.pursue(goal=0.0)
        assert_allclose(found.error, 0, atol=1e-10)

    def test_it_does_not_matter_which_images_are_pursued_together(
        self, make_scene, monkeypatch
    ):
        scene = make_scene(n=40, noise=0.3)

        together = scene.pursue(max_atoms=4)
        monkeypatch.setattr(matching_pursuit, "IMAGES_PURSUED_AT_ONCE", 7)
        apart = scene.pursue(max_atoms=4)

        for one, other in zip(together, apart, strict=True):
            assert_array_equal(one, other)


class TestImagesThatCannotBePursued:
    """Images 1 and 3 have too few landmarks, image 2 weights whose squares overflow."""

    @pytest.fixture
    def scene(self, make_scene):
        return make_scene()

    @pytest.fixture
    def expected(self, scene):
        """What is found before the images are spoilt."""
        return scene.pursue()

    @pytest.fixture
    def found(self, scene, expected):
        scene.weights[1] = 0
        scene.weights[3, 1:] = 0
        scene.weights[2] = 1e200
        return scene.pursue()

    def test_they_say_why(self, found):
        assert found.status[1] is Status.DEGENERATE
        assert found.status[2] is Status.NUMERICAL_FAILURE
        assert found.status[3] is Status.DEGENERATE

    def test_they_have_no_camera(self, found):
        assert np.isnan(found.rotation[1:4]).all()
        assert np.isnan(found.scale[1:4]).all()

    def test_they_leave_the_others_alone(self, found, expected):
        others = [0, 4]
        coefficients = expected.coefficients[others]
        assert_array_equal(found.coefficients[others], coefficients)


class TestEstimate:
    def test_the_scales_of_the_camera_become_one(self, noisy):
        """Their mean, which goes to the shape."""
        pursuit = noisy.pursue()
        size = pursuit.scale.mean(axis=1)

        found = noisy.estimate()

        turned = found.rotation @ noisy.mix(pursuit)
        coefficients = size[:, None] * pursuit.coefficients
        assert_allclose(found.shapes, resized(turned, size), atol=1e-12)
        assert_allclose(found.coefficients, coefficients, atol=1e-12)

    def test_the_rotation_is_that_of_the_camera(self, noisy):
        found = noisy.estimate()
        assert_array_equal(found.rotation, noisy.pursue().rotation)
        assert_allclose(np.linalg.det(found.rotation), 1)

    def test_lifted_shapes_lie_where_the_true_ones_do(self, make_scene):
        """The mean shape, turned, in pixels, with hidden landmarks: no atom is
        needed.
        """
        scene = make_scene(active=0, hidden=0.2)
        shapes = 40 * scene.shapes
        shapes[:, :2] += 300
        landmarks = shapes[:, :2]
        pursuit = method(scene.mean, scene.edges)

        found = lift(landmarks, scene.weights, scene.bases, Program(lam=0.1), pursuit)

        assert not found.failures
        assert_allclose(found.shapes, shapes, atol=1e-9)


def minimise(G, g, radius, before):
    """Return the minimiser of y^T G y / 2 - g^T y with ||y|| = radius, which of two is
    that nearer to `before`.
    """
    (y,) = minimise_on_sphere(G[None], g[None], radius, before[None])
    return y


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
            G = A.T @ A
            g = A.T @ rng.standard_normal(len(A))

            y = minimise(G, g, radius, before=np.ones(m))

            multiplier = (g - G @ y) @ y / radius**2
            gradient = G @ y + multiplier * y - g
            size = np.linalg.norm(G, 2) + np.linalg.norm(g) / radius
            least_eigenvalue = np.linalg.eigvalsh(G)[0]
            assert np.linalg.norm(y) == pytest.approx(radius, rel=1e-14)
            assert np.linalg.norm(gradient) <= 1e-12 * size * radius
            assert least_eigenvalue + multiplier >= -1e-13 * size

    @pytest.mark.parametrize("side", [-1, 1])
    def test_of_two_minimisers_the_nearer_is_taken(self, side):
        """g has no part along the least eigenvalue but rounding: the eigenvector fills
        up y.
        """
        radius = 1.7
        G = 1e8 * np.diag([1.0, 3.0, 4.0])
        g = 1e8 * np.array([1e-17, 2.0, 0.0])

        y = minimise(G, g, radius, before=np.array([side, 0.1, 0.2]))

        along_the_least = side * np.sqrt(radius**2 - 1)
        assert_allclose(y, [along_the_least, 1, 0], atol=1e-14)


class TestScales:
    """argmin_{s >= 0} ||w - diag(s) R S||^2, by row, beside non-negative least
    squares.
    """

    N = 40

    @pytest.fixture
    def R(self, rng):
        return random_rotations(self.N, rng)[:, :2]

    @pytest.fixture
    def S(self, rng):
        return rng.standard_normal((self.N, 3, P))

    @pytest.fixture(params=[1.0, 1e-3])
    def w(self, request, rng):
        """Landmarks at random: of about half of the rows the best scale is 0."""
        return request.param * rng.standard_normal((self.N, 2, P))

    @pytest.fixture
    def expected(self, R, S, w):
        """Scales (N, 2), and the squared errors (N, 2) that they leave."""
        rows = R @ S
        fits = [
            [nnls(rows[i, a][:, None], w[i, a]) for a in range(2)]
            for i in range(self.N)
        ]
        scale = np.array([[x[0] for x, _ in image] for image in fits])
        error = np.array([[norm**2 for _, norm in image] for image in fits])
        return scale, error

    @pytest.fixture
    def found(self, R, S, w):
        return fit_scales(R, w @ S.swapaxes(1, 2), S @ S.swapaxes(1, 2))

    def test_they_are_the_best_that_are_not_negative(self, found, expected):
        scale, _ = expected
        assert (scale == 0).any()
        assert_allclose(found[0], scale, atol=1e-12)

    def test_the_gain_is_what_the_error_loses(self, found, expected, w):
        _, error = expected
        gain = (w**2).sum(axis=(1, 2)) - error.sum(axis=1)
        assert_allclose(found[1], gain, atol=1e-12)
