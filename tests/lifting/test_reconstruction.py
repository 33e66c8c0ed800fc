import numpy as np
import pytest

from shapefit.convex.transforms import Transforms
from shapefit.geometry.rotations import random_rotations
from shapefit.lifting.reconstruction import reconstruct


@pytest.fixture
def planted(rng):
    """Return c, a rotation for each atom, and the atoms."""
    n, k, p = 5, 6, 9
    c = np.where(rng.random((n, k)) < 0.5, rng.uniform(0.5, 2, (n, k)), 0.0)
    c[:, 0] = 1.0
    return c, random_rotations(n * k, rng).reshape(n, k, 3, 3), rng.standard_normal((k, 3, p))


def transforms(c, R):
    return c[..., None, None] * R[..., :2, :]


def test_all_of_it_is_what_singular_value_decompositions_say(planted, rng):
    c, R, atoms = planted
    M = transforms(c, R) + 0.3 * (c > 0)[..., None, None] * rng.standard_normal((5, 6, 2, 3))
    found = reconstruct(Transforms.of(M), atoms)
    s = np.linalg.svd(M, compute_uv=False)
    size = np.where(s[..., :1] > 0, s[..., :1], 1.0)
    third = np.cross(M[..., 0, :], M[..., 1, :]) / size
    turned = np.concatenate([M, third[..., None, :]], axis=2) * (c > 0)[..., None, None]
    np.testing.assert_allclose(found.coefficients, s[..., 0], atol=1e-13)
    np.testing.assert_allclose(found.shapes, np.einsum("nkab,kbp->nap", turned, atoms), atol=1e-12)
    for A, nearest in zip(turned.sum(axis=1), found.rotation, strict=True):
        U, _, Vt = np.linalg.svd(A)
        flip = np.diag([1.0, 1.0, np.linalg.det(U @ Vt)])
        np.testing.assert_allclose(nearest, U @ flip @ Vt, atol=1e-11)
    np.testing.assert_array_equal(found.active_atoms, (c > 0).sum(axis=1))
    np.testing.assert_array_equal(found.tight, (s[..., 0] - s[..., 1] < 1e-9).all(axis=1))


def test_without_coefficients_there_is_no_rotation(planted):
    c, R, atoms = planted
    M = transforms(c, R)
    M[2] = 0.0
    found = reconstruct(Transforms.of(M), atoms)
    assert np.isnan(found.rotation[2]).all()
    assert np.isfinite(np.delete(found.rotation, 2, axis=0)).all()
    np.testing.assert_array_equal(found.shapes[2], 0.0)
    assert found.active_atoms[2] == 0
    assert not found.tight[2]
