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


@pytest.fixture
def scene(make_scene):
    return make_scene(n=5, noise=0.3, weighted=True, hidden=0.2)


@pytest.fixture
def run(scene):
    def run(lam, method="convex+refine"):
        estimate = make_estimator(method, mean_shape=scene.mean_shape)
        return estimate(scene.problem(lam))

    return run


def test_a_shape_is_placed_where_no_other_place_is_better(scene, rng):
    problem, S = scene.problem(0.1), rng.standard_normal((5, 2, 12))
    placed = fit_translation(problem, S)
    for i in range(5):
        w = scene.weights[i]

        def half_squared_residual(T, points=problem.landmarks[i], w=w):
            return 0.5 * ((w * (points - T[:, None])) ** 2).sum()

        best = minimize(
            half_squared_residual,
            np.zeros(2),
            args=(problem.landmarks[i] - S[i], w),
            tol=1e-12,
        )
        assert_allclose(placed.translation[i], best.x, atol=1e-6)
        assert_allclose(placed.half_squared_residual[i], best.fun, rtol=1e-9)
        whole = minimize(half_squared_residual, np.zeros(2), tol=1e-12).fun
        assert_allclose(placed.residual[i], np.sqrt(best.fun / whole), rtol=1e-9)


def test_images_of_two_estimates_are_joined_in_the_order_asked_for(run):
    one, other = (replace(run(lam), tight=np.full(5, lam > 0.5)) for lam in (0.1, 1.0))
    order = np.array([7, 0, 5, 3])
    both = join_images([one, other], order)
    for field in fields(one):
        first, second = getattr(one, field.name), getattr(other, field.name)
        if isinstance(first, np.ndarray):
            expected = np.stack([second[2], first[0], second[0], first[3]])
            assert_array_equal(getattr(both, field.name), expected)
    assert both.status == (
        other.status[2],
        one.status[0],
        other.status[0],
        one.status[3],
    )
    assert_array_equal(both.tight, [True, False, True, False])
    assert_array_equal(
        both.transforms.dense()[[0, 1]],
        [other.transforms.dense()[2], one.transforms.dense()[0]],
    )


@pytest.fixture
def planted(rng):
    """Return c, a rotation for each atom, and the atoms."""
    n, k, p = 5, 6, 9
    c = np.where(rng.random((n, k)) < 0.5, rng.uniform(0.5, 2, (n, k)), 0.0)
    c[:, 0] = 1.0
    return (
        c,
        random_rotations(n * k, rng).reshape(n, k, 3, 3),
        rng.standard_normal((k, 3, p)),
    )


def transforms(c, R):
    return c[..., None, None] * R[..., :2, :]


def test_all_of_it_is_what_singular_value_decompositions_say(planted, rng):
    c, R, atoms = planted
    M = transforms(c, R) + 0.3 * (c > 0)[..., None, None] * rng.standard_normal(
        (5, 6, 2, 3)
    )
    found = reconstruct(Transforms.of(M), atoms)
    s = np.linalg.svd(M, compute_uv=False)
    size = np.where(s[..., :1] > 0, s[..., :1], 1.0)
    third = np.cross(M[..., 0, :], M[..., 1, :]) / size
    turned = np.concatenate([M, third[..., None, :]], axis=2) * (c > 0)[..., None, None]
    assert_allclose(found.coefficients, s[..., 0], atol=1e-13)
    assert_allclose(found.shapes, np.einsum("nkab,kbp->nap", turned, atoms), atol=1e-12)
    for A, nearest in zip(turned.sum(axis=1), found.rotation, strict=True):
        U, _, Vt = np.linalg.svd(A)
        flip = np.diag([1.0, 1.0, np.linalg.det(U @ Vt)])
        assert_allclose(nearest, U @ flip @ Vt, atol=1e-11)
    assert_array_equal(found.active_atoms, (c > 0).sum(axis=1))
    assert_array_equal(found.tight, (s[..., 0] - s[..., 1] < 1e-9).all(axis=1))


@pytest.mark.parametrize(("off", "tight"), [(0.9e-3, True), (1.1e-3, False)])
def test_transforms_are_tight_where_rows_are_orthogonal_to_a_thousandth(
    rng, off, tight
):
    """||M M^T / c^2 - I||_F = off for the second of two transforms."""
    R = random_rotations(2, rng)
    M = R[:, :2].copy()
    M[1] = 3 * np.diag([1, np.sqrt(1 - off)]) @ R[1, :2]
    found = reconstruct(Transforms.of(M[None]), rng.standard_normal((2, 3, 7)))
    assert found.tight[0] == tight


def test_without_coefficients_there_is_no_rotation(planted):
    c, R, atoms = planted
    M = transforms(c, R)
    M[2] = 0.0
    found = reconstruct(Transforms.of(M), atoms)
    assert np.isnan(found.rotation[2]).all()
    assert np.isfinite(np.delete(found.rotation, 2, axis=0)).all()
    assert_array_equal(found.shapes[2], 0.0)
    assert found.active_atoms[2] == 0
    assert not found.tight[2]
