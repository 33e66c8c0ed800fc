import numpy as np
import pytest
from scipy.linalg import polar

from shapefit import core
from shapefit.convex.transforms import Transforms
from shapefit.geometry.rotations import (
    nearest_rotation,
    random_rotations,
    rotation_about,
    rotation_angle,
)
from shapefit.lifting.reconstruction import (
    complete_transforms,
    is_active,
    orthogonal_transforms,
    reconstruct,
)


@pytest.fixture
def planted(rng):
    """Return c, a rotation for each atom, and the atoms."""
    n, k, p = 5, 6, 9
    c = np.where(rng.random((n, k)) < 0.5, rng.uniform(0.5, 2, (n, k)), 0.0)
    c[:, 0] = 1.0
    return c, random_rotations(n * k, rng).reshape(n, k, 3, 3), rng.standard_normal((k, 3, p))


def transforms(c, R):
    return c[..., None, None] * R[..., :2, :]


@pytest.mark.parametrize("orthogonal", [False, True])
def test_planted_coefficients_and_shapes_come_back(planted, orthogonal):
    c, R, atoms = planted
    found = reconstruct(Transforms.of(transforms(c, R)), atoms, orthogonal=orthogonal)
    np.testing.assert_allclose(found.coefficients, c, atol=1e-14)
    np.testing.assert_allclose(
        found.shapes, np.einsum("nk,nkab,kbp->nap", c, R, atoms), rtol=0, atol=1e-13
    )
    assert found.tight.all()
    np.testing.assert_array_equal(found.active_atoms, (c > 0).sum(axis=1))


@pytest.mark.parametrize("orthogonal", [False, True])
def test_all_of_it_is_what_singular_value_decompositions_say(planted, rng, orthogonal):
    c, R, atoms = planted
    M = transforms(c, R) + 0.3 * (c > 0)[..., None, None] * rng.standard_normal((5, 6, 2, 3))
    found = reconstruct(Transforms.of(M), atoms, orthogonal=orthogonal)
    U, s, Vt = np.linalg.svd(M, full_matrices=False)
    rows = s[..., :1, None] * (U @ Vt) if orthogonal else M
    size = np.where(s[..., :1] > 0, s[..., :1], 1.0)
    third = np.cross(rows[..., 0, :], rows[..., 1, :]) / size
    turned = np.concatenate([rows, third[..., None, :]], axis=2) * (c > 0)[..., None, None]
    np.testing.assert_allclose(found.coefficients, s[..., 0], atol=1e-13)
    np.testing.assert_allclose(found.shapes, np.einsum("nkab,kbp->nap", turned, atoms), atol=1e-12)
    for A, nearest in zip(turned.sum(axis=1), found.rotation, strict=True):
        U, _, Vt = np.linalg.svd(A)
        flip = np.diag([1.0, 1.0, np.linalg.det(U @ Vt)])
        np.testing.assert_allclose(nearest, U @ flip @ Vt, atol=1e-11)
    np.testing.assert_array_equal(found.active_atoms, (c > 0).sum(axis=1))
    np.testing.assert_array_equal(found.tight, (s[..., 0] - s[..., 1] < 1e-9).all(axis=1))


def test_threads_and_neighbours_change_no_bit(rng):
    M = Transforms.of(rng.standard_normal((200, 4, 2, 3)) * (rng.random((200, 4, 1, 1)) < 0.6))
    atoms, some = rng.standard_normal((4, 3, 9)), np.array([5, 199, 64])
    one, two = (reconstruct(M, atoms, threads=threads) for threads in (1, 3))
    few = reconstruct(M.take(some), atoms)
    for name in ("shapes", "coefficients", "rotation", "active_atoms", "tight"):
        np.testing.assert_array_equal(getattr(two, name), getattr(one, name))
        np.testing.assert_array_equal(getattr(few, name), getattr(one, name)[some])


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_nearest_rotation_is_proper_and_nearest(rng, sign):
    for A in rng.standard_normal((50, 3, 3)) * 10.0 ** rng.uniform(-6, 6, (50, 1, 1)):
        A *= sign * np.sign(np.linalg.det(A))
        R = np.empty((3, 3))
        core.parts.nearest_rotation(A, R)
        assert np.linalg.det(R) == pytest.approx(1)
        np.testing.assert_allclose(R, nearest_rotation(A), atol=1e-9)


def test_planted_rotations_come_back(planted):
    c, R, _ = planted
    turned = complete_transforms(transforms(c, R))
    np.testing.assert_allclose(turned, c[..., None, None] * R, atol=1e-14)


def test_a_shared_rotation_is_the_consensus(planted):
    c, R, atoms = planted
    shared = np.broadcast_to(R[:, :1], R.shape)
    found = reconstruct(Transforms.of(transforms(c, shared)), atoms)
    assert rotation_angle(found.rotation, R[:, 0]).max() < 1e-6


def test_the_consensus_leans_to_the_larger_coefficients(rng):
    axis = np.array([0.0, 0.0, 1.0])
    R = rotation_about(axis, np.array([0.0, 0.2]))[None]
    M = Transforms.of(transforms(np.array([[3.0, 1.0]]), R))
    found = reconstruct(M, rng.standard_normal((2, 3, 4)))
    angle = np.arctan2(np.sin(0.2), 3 + np.cos(0.2))  # of 3 exp(0) + exp(0.2 i)
    np.testing.assert_allclose(found.rotation, rotation_about(axis, np.array([angle])), atol=1e-12)


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


def test_the_coefficient_of_a_loose_transform_is_its_spectral_norm(rng):
    M = rng.standard_normal((4, 3, 2, 3))
    atoms = rng.standard_normal((3, 3, 7))
    found = reconstruct(Transforms.of(M), atoms)
    np.testing.assert_allclose(found.coefficients, np.linalg.norm(M, 2, axis=(2, 3)))
    np.testing.assert_allclose(found.shapes[:, :2], np.einsum("nkab,kbp->nap", M, atoms))
    assert not found.tight.any()


def test_a_slightly_loose_active_transform_is_not_tight_and_a_negligible_one_does_not_count(rng):
    M = np.stack([random_rotations(1, rng)[0, :2], np.array([[1.0, 0, 0], [0, 0.99, 0]])])
    atoms = rng.standard_normal((2, 3, 5))
    assert not reconstruct(Transforms.of(M[None]), atoms).tight[0]
    M[1] *= 1e-8
    assert reconstruct(Transforms.of(M[None]), atoms).tight[0]


def test_orthogonal_transforms_are_the_polar_factors(rng):
    M = rng.standard_normal((20, 2, 3))
    for block, turned in zip(M, orthogonal_transforms(M), strict=True):
        factor, _ = polar(block)
        c = np.linalg.norm(block, 2)
        np.testing.assert_allclose(turned[:2], c * factor, atol=1e-12)
        np.testing.assert_allclose(turned @ turned.T, c**2 * np.eye(3), atol=1e-12)
        assert np.linalg.det(turned) > 0


def test_the_third_row_follows_from_the_first_two(rng):
    M = rng.standard_normal((1, 1, 2, 3))
    third = complete_transforms(M)[0, 0, 2]
    np.testing.assert_allclose(
        third, np.cross(M[0, 0, 0], M[0, 0, 1]) / np.linalg.norm(M[0, 0], 2), atol=1e-14
    )


def test_a_turn_of_the_camera_turns_the_shapes(planted):
    c, R, atoms = planted
    Q = rotation_about(np.array([0.0, 0.0, 1.0]), np.array([0.7]))[0]
    before, after = (reconstruct(Transforms.of(transforms(c, X)), atoms) for X in (R, Q @ R))
    np.testing.assert_allclose(after.shapes, Q @ before.shapes, atol=1e-12)
    np.testing.assert_allclose(after.rotation, Q @ before.rotation, atol=1e-10)


def test_activity_is_beside_the_largest_of_the_image():
    c = np.array([[1.0, 1e-7, -0.5], [1e-9, 1e-8, 0.0], [0.0, 0.0, 0.0]])
    np.testing.assert_array_equal(
        is_active(c), [[True, False, True], [True, True, False], [False, False, False]]
    )
