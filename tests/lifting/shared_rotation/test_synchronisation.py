"""The rotation nearest to transforms: shared ones, loose ones, and none."""

from typing import NamedTuple

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from shapefit.convex.transforms import Transforms
from shapefit.geometry.rotations import random_rotations
from shapefit.lifting import shared_rotation
from tests.points import transpose


class Synchronised(NamedTuple):
    """The rotation found, and the best c >= 0 at it."""

    rotation: np.ndarray
    coefficients: np.ndarray


def products(M, R):
    """Return <M_i, Rbar> / 2 (n, k)."""
    return np.einsum("nkab,nab->nk", M, R[:, :2]) / 2


def synchronise(M):
    R = shared_rotation.synchronise(Transforms.of(M))
    c = np.maximum(products(M, R), 0.0)
    return Synchronised(R, np.nan_to_num(c))


@pytest.fixture
def loose(rng):
    """Return transforms around a shared rotation, far from it, with some zeros."""
    R = random_rotations(12, rng)
    size = rng.uniform(0, 2, (12, 9, 1, 1))
    M = size * (R[:, None, :2] + 0.7 * rng.standard_normal((12, 9, 2, 3)))
    M[:, 6:] = 0.0
    return M


def test_transforms_that_share_a_rotation_give_it_exactly(rng):
    R = random_rotations(20, rng)
    c = rng.uniform(0, 2, (20, 7)) * (rng.random((20, 7)) < 0.6)
    c[:, 2] = 0.5

    found = synchronise(c[..., None, None] * R[:, None, :2])

    assert_allclose(found.rotation, R, atol=1e-13)
    assert_allclose(found.coefficients, c, atol=1e-13)


def test_the_answer_is_a_rotation(loose):
    """Its rows have the norm 1, and the determinant is 1: so they are orthogonal."""
    R = synchronise(loose).rotation
    assert_allclose(np.linalg.norm(R, axis=2), 1, atol=1e-14)
    assert_allclose(np.linalg.det(R), 1)


def test_the_answer_is_a_stationary_point(loose):
    """sum_i c_i M_i Rbar^T is symmetric and positive semidefinite."""
    found = synchronise(loose)
    rows = found.rotation[:, :2]
    X = np.einsum("nk,nkab,ncb->nac", found.coefficients, loose, rows)
    assert_allclose(X, transpose(X), atol=1e-9)
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

    others = np.delete(found.rotation, 3, axis=0)
    assert np.isnan(found.rotation[3]).all()
    assert_array_equal(found.coefficients[3], 0.0)
    assert np.isfinite(others).all()
