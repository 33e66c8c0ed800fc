"""Rotations: proper, nearest, uniform; scipy as the independent judge."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy import linalg
from scipy.spatial.transform import Rotation

from shapefit.geometry.rotations import (
    complete_rotation,
    nearest_rotation,
    random_rotations,
    rotation_about,
    rotation_angle,
)


def assert_proper(R):
    assert_allclose(
        R @ R.swapaxes(-1, -2), np.broadcast_to(np.eye(3), R.shape), atol=1e-13
    )
    assert_allclose(np.linalg.det(R), 1, atol=1e-13)


class TestNearestRotation:
    @pytest.fixture
    def matrices(self, rng):
        return rng.standard_normal((50, 3, 3))

    def test_certificate(self, matrices):
        # R maximises <R, A> over rotations iff R^T A is symmetric and the sum of any
        # two of its eigenvalues is >= 0 (a turn by t about the third axis costs (1 -
        # cos t) times that sum).
        P = nearest_rotation(matrices).swapaxes(-1, -2) @ matrices
        assert_allclose(P, P.swapaxes(-1, -2), atol=1e-12)
        low = np.linalg.eigvalsh(P)[:, :2]
        assert (low.sum(axis=1) >= -1e-12).all()


class TestCompleteRotation:
    def test_rows_are_the_polar_factor(self, rng):
        rows = rng.standard_normal((20, 2, 3))
        R = complete_rotation(rows)
        assert_proper(R)
        expected = np.array([linalg.polar(matrix, side="left")[0] for matrix in rows])
        assert_allclose(R[:, :2], expected, atol=1e-12)


class TestRandomRotations:
    def test_moments_of_the_uniform_distribution(self, rng):
        # Under Haar measure E R = 0, E R_ij R_kl = 1/3 if (i, j) = (k, l) and 0
        # otherwise.
        R = random_rotations(100_000, rng).reshape(-1, 9)
        assert_allclose(R.mean(axis=0), 0, atol=0.01)
        assert_allclose(R.T @ R / len(R), np.eye(9) / 3, atol=0.01)


class TestRotationAbout:
    def test_agrees_with_scipy(self, rng):
        axis, angles = rng.standard_normal(3), rng.uniform(-10, 10, 30)
        expected = Rotation.from_rotvec(
            angles[:, None] * axis / np.linalg.norm(axis)
        ).as_matrix()
        assert_allclose(rotation_about(axis, angles), expected, atol=1e-13)


class TestRotationAngle:
    def test_agrees_with_scipy(self, rng):
        first, second = random_rotations(50, rng), random_rotations(50, rng)
        expected = (
            Rotation.from_matrix(first).inv() * Rotation.from_matrix(second)
        ).magnitude()
        assert_allclose(rotation_angle(first, second), np.degrees(expected), rtol=1e-9)

    @pytest.mark.parametrize("degrees", [0.0, 1e-9, 1e-4, 90, 179.999, 180])
    def test_is_exact_at_both_ends(self, degrees, rng):
        start = random_rotations(1, rng)[0]
        turn = rotation_about(np.array([1.0, -2, 0.5]), np.array(np.radians(degrees)))
        tolerance = 1e-13 if degrees < 1 else 1e-5
        assert rotation_angle(start, start @ turn) == pytest.approx(
            degrees, rel=1e-6, abs=tolerance
        )
