"""Shapes of transforms by SVDs; placing them on landmarks, and joining estimates."""

from dataclasses import fields, replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.optimize import minimize

from shapefit.convex.transforms import Transforms
from shapefit.geometry.rotations import random_rotations
from shapefit.lifting.estimate import fit_translation, join_images
from shapefit.lifting.reconstruction import reconstruct
from tests.lifting.estimators import make_estimator
from tests.points import draw_rotations, transform, with_noise


@pytest.fixture
def scene(make_scene):
    return make_scene(n=5, noise=0.3, weighted=True, hidden=0.2)


def half_squared_residual(T, points, weights):
    """Return 1/2 ||omega o (points - T 1^T)||^2."""
    residual = weights * (points - T[:, None])
    return 0.5 * (residual**2).sum()


def place(points, weights):
    """Return the best translation and what it leaves, by a general minimiser."""
    return minimize(
        half_squared_residual, np.zeros(2), args=(points, weights), tol=1e-12
    )


@pytest.mark.parametrize("image", range(5))
class TestTranslation:
    """Shapes are placed where no other place is better."""

    @pytest.fixture
    def shapes(self, rng):
        return rng.standard_normal((5, 2, 12))

    @pytest.fixture
    def placed(self, scene, shapes):
        return fit_translation(scene.problem(0.1), shapes)

    @pytest.fixture
    def best(self, scene, shapes, image):
        problem = scene.problem(0.1)
        away = problem.landmarks[image] - shapes[image]
        return place(away, scene.weights[image])

    def test_it_is_that_of_a_general_minimiser(self, placed, best, image):
        residual = placed.half_squared_residual[image]
        assert_allclose(placed.translation[image], best.x, atol=1e-6)
        assert_allclose(residual, best.fun, rtol=1e-9)

    def test_the_residual_is_a_share_of_what_is_left_without_a_shape(
        self, scene, placed, best, image
    ):
        landmarks = scene.problem(0.1).landmarks[image]
        without_shape = place(landmarks, scene.weights[image])
        expected = np.sqrt(best.fun / without_shape.fun)
        assert_allclose(placed.residual[image], expected, rtol=1e-9)


class TestJoin:
    """Images 7, 0, 5 and 3 of two estimates of five images each."""

    ORDER = np.array([7, 0, 5, 3])

    def estimate(self, scene, lam, *, tight):
        estimator = make_estimator("convex+refine", mean_shape=scene.mean_shape)
        estimate = estimator(scene.problem(lam))
        return replace(estimate, tight=np.full(5, tight))

    @pytest.fixture
    def first(self, scene):
        return self.estimate(scene, 0.1, tight=False)

    @pytest.fixture
    def second(self, scene):
        return self.estimate(scene, 1.0, tight=True)

    @pytest.fixture
    def joined(self, first, second):
        return join_images([first, second], self.ORDER)

    def test_arrays_are_in_the_order_asked_for(self, joined, first, second):
        for field in fields(first):
            one = getattr(first, field.name)
            other = getattr(second, field.name)
            if isinstance(one, np.ndarray):
                expected = np.stack([other[2], one[0], other[0], one[3]])
                assert_array_equal(getattr(joined, field.name), expected)

    def test_tight_images_are_those_of_the_second(self, joined):
        assert_array_equal(joined.tight, [True, False, True, False])

    def test_the_status_goes_with_the_image(self, joined, first, second):
        one, other = first.status, second.status
        assert joined.status == (other[2], one[0], other[0], one[3])

    def test_transforms_go_with_the_image(self, joined, first, second):
        M = joined.transforms.dense()
        assert_array_equal(M[0], second.transforms.dense()[2])
        assert_array_equal(M[1], first.transforms.dense()[0])


N = 5
"""Images."""

K = 6
"""Atoms."""


@pytest.fixture
def coefficients(rng):
    """About half of them are used, among them the first of each image."""
    is_used = rng.random((N, K)) < 0.5
    c = np.where(is_used, rng.uniform(0.5, 2, (N, K)), 0.0)
    c[:, 0] = 1.0
    return c


@pytest.fixture
def rotations(rng):
    """A rotation for each atom of each image."""
    return draw_rotations(N, K, rng)


@pytest.fixture
def atoms(rng):
    return rng.standard_normal((K, 3, 9))


@pytest.fixture
def transforms(coefficients, rotations):
    """M_i = c_i Rbar_i."""
    return coefficients[..., None, None] * rotations[..., :2, :]


class TestReconstruction:
    """All of it is what singular value decompositions say of transforms whose two rows
    are no longer orthogonal.
    """

    @pytest.fixture
    def noisy(self, transforms, coefficients, rng):
        is_used = (coefficients > 0)[..., None, None]
        return with_noise(transforms, 0.3 * is_used, rng)

    @pytest.fixture
    def found(self, noisy, atoms):
        return reconstruct(Transforms.of(noisy), atoms)

    @pytest.fixture
    def singular_values(self, noisy):
        return np.linalg.svd(noisy, compute_uv=False)

    @pytest.fixture
    def completed(self, noisy, singular_values):
        """Transforms with a third row: the cross product, as long as the norm."""
        norm = singular_values[..., :1]
        third = np.cross(noisy[..., 0, :], noisy[..., 1, :])
        third = np.divide(third, norm, out=np.zeros_like(third), where=norm > 0)
        return np.concatenate([noisy, third[..., None, :]], axis=2)

    def test_coefficients_are_spectral_norms(self, found, singular_values):
        assert_allclose(found.coefficients, singular_values[..., 0], atol=1e-13)

    def test_shapes_have_depth_by_the_third_row(self, found, completed, atoms):
        assert_allclose(found.shapes, transform(completed, atoms), atol=1e-12)

    def test_rotations_are_nearest_to_the_sum(self, found, completed):
        for A, nearest in zip(completed.sum(axis=1), found.rotation, strict=True):
            U, _, Vt = np.linalg.svd(A)
            flip = np.diag([1.0, 1.0, np.linalg.det(U @ Vt)])
            assert_allclose(nearest, U @ flip @ Vt, atol=1e-11)

    def test_active_atoms_are_counted(self, found, coefficients):
        count = (coefficients > 0).sum(axis=1)
        assert_array_equal(found.active_atoms, count)

    def test_no_image_is_tight(self, found, singular_values):
        difference = singular_values[..., 0] - singular_values[..., 1]
        assert_array_equal(found.tight, (difference < 1e-9).all(axis=1))


@pytest.mark.parametrize(("off", "tight"), [(0.9e-3, True), (1.1e-3, False)])
def test_transforms_are_tight_where_rows_are_orthogonal_to_a_thousandth(
    rng, off, tight
):
    """||M M^T / c^2 - I||_F = off for the second of two transforms."""
    M = random_rotations(2, rng)[:, :2]
    second_row_shorter = np.diag([1, np.sqrt(1 - off)])
    M[1] = 3 * second_row_shorter @ M[1]
    atoms = rng.standard_normal((2, 3, 7))

    found = reconstruct(Transforms.of(M[None]), atoms)

    assert found.tight[0] == tight


def test_without_coefficients_there_is_no_rotation(transforms, atoms):
    transforms[2] = 0.0

    found = reconstruct(Transforms.of(transforms), atoms)

    others = np.delete(found.rotation, 2, axis=0)
    assert np.isnan(found.rotation[2]).all()
    assert np.isfinite(others).all()
    assert_array_equal(found.shapes[2], 0.0)
    assert found.active_atoms[2] == 0
    assert not found.tight[2]
