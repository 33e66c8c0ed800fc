"""Which rotations pass for the nearest one, and which do not."""

import numpy as np
import pytest

from shapefit.geometry.rotations import nearest_rotation, random_rotations, rotation_about
from shapefit.verification.proofs.reconstruction import check_nearest, check_proper

N = 40
BOUND = 1e-12


@pytest.fixture
def sums(rng):
    """Sums of scaled rotations (n, 3, 3), some of them nearer to reflections than to rotations."""
    A = rng.standard_normal((N, 3, 3))
    return A / np.linalg.norm(A, axis=(1, 2))[:, None, None]


def missed(rotation, total):
    checks = check_nearest(rotation, total, np.ones(len(total)), np.full(len(total), BOUND))
    return np.any([one.missed for one in checks], axis=0)


def test_the_nearest_rotation_passes(sums):
    assert (np.linalg.det(sums) < 0).any()
    assert not missed(nearest_rotation(sums), sums).any()


def test_a_turned_rotation_does_not(sums, rng):
    turn = rotation_about(rng.standard_normal(3), np.array([1e-9]))[0]
    assert missed(turn @ nearest_rotation(sums), sums).all()


def test_other_stationary_rotations_do_not(sums):
    """Half a turn about a singular vector leaves R^T A symmetric, and is not the nearest."""
    U, _, Vt = np.linalg.svd(sums)
    proper = np.sign(np.linalg.det(U @ Vt))
    for flips in ([1, -1, -1], [-1, 1, -1], [-1, -1, 1]):
        signs = np.tile(np.array(flips, dtype=float), (N, 1))
        signs[:, 2] *= proper
        assert missed((U * signs[:, None]) @ Vt, sums).all()


def test_no_rotation_stands_where_nothing_was_turned(sums):
    R = nearest_rotation(sums)
    absent = np.zeros(N)
    found = check_nearest(R, np.zeros_like(sums), absent, absent)
    assert np.any([one.missed for one in found], axis=0).all()
    found = check_nearest(np.full_like(R, np.nan), np.zeros_like(sums), absent, absent)
    assert not np.any([one.missed for one in found], axis=0).any()


def test_reflections_and_sheared_matrices_are_no_rotations(rng):
    R = random_rotations(N, rng)
    allowed, every = np.full(N, BOUND), np.ones(N, dtype=bool)
    assert not check_proper(R, allowed, every).missed.any()
    assert check_proper(-R, allowed, every).missed.all()
    assert check_proper(R * (1 + 1e-9), allowed, every).missed.all()
