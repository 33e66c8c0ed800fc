"""Rotations: proper, nearest, uniform; scipy as the independent judge."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy import linalg
from scipy.spatial.transform import Rotation

from shapefit.geometry.rotations import (
    complete_rotation,
    exponential,
    nearest_rotation,
    random_rotations,
    rotation_about,
    rotation_angle,
    shortest_rotations,
)
from tests.points import assert_rotations, transpose


class TestNearestRotation:
    """R maximises <R, A> over rotations if and only if R^T A is symmetric and the sum
    of any two of its eigenvalues is >= 0: a turn by t about the third axis costs
    (1 - cos t) times that sum.
    """

    def test_certificate(self, rng):
        A = rng.standard_normal((50, 3, 3))

        R = nearest_rotation(A)

        P = transpose(R) @ A
        assert_allclose(P, transpose(P), atol=1e-12)
        two_least = np.linalg.eigvalsh(P)[:, :2]
        assert (two_least.sum(axis=1) >= -1e-12).all()


class TestCompleteRotation:
    @pytest.fixture
    def rows(self, rng):
        return rng.standard_normal((20, 2, 3))

    def test_it_is_a_rotation(self, rows):
        assert_rotations(complete_rotation(rows), atol=1e-13)

    def test_rows_are_the_polar_factor(self, rows):
        R = complete_rotation(rows)
        expected = [linalg.polar(matrix, side="left")[0] for matrix in rows]
        assert_allclose(R[:, :2], expected, atol=1e-12)


class TestRandomRotations:
    def test_moments_of_the_uniform_distribution(self, rng):
        """Under Haar measure E R = 0, E R_ij R_kl = 1/3 if (i, j) = (k, l) and 0
        otherwise.
        """
        R = random_rotations(100_000, rng).reshape(-1, 9)
        second_moments = R.T @ R / len(R)
        assert_allclose(R.mean(axis=0), 0, atol=0.01)
        assert_allclose(second_moments, np.eye(9) / 3, atol=0.01)


class TestRotationAbout:
    def test_agrees_with_scipy(self, rng):
        axis = rng.standard_normal(3)
        angles = rng.uniform(-10, 10, 30)
        vectors = angles[:, None] * axis / np.linalg.norm(axis)
        expected = Rotation.from_rotvec(vectors).as_matrix()
        assert_allclose(rotation_about(axis, angles), expected, atol=1e-13)


class TestExponential:
    @pytest.mark.parametrize("size", [0.0, 1e-12, 1e-3, 1.0, 10.0])
    def test_agrees_with_scipy(self, rng, size):
        turns = size * rng.standard_normal((4, 5, 3))
        vectors = turns.reshape(-1, 3)
        expected = Rotation.from_rotvec(vectors).as_matrix().reshape(4, 5, 3, 3)
        assert_allclose(exponential(turns), expected, rtol=1e-12, atol=1e-14)


class TestShortestRotations:
    @pytest.fixture
    def start(self, rng):
        direction = rng.standard_normal(3)
        return direction / np.linalg.norm(direction)

    @pytest.fixture
    def across(self, rng, start):
        """Unit vectors (30, 3) at right angles to the start."""
        vectors = np.cross(start, rng.standard_normal((30, 3)))
        return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)

    @pytest.mark.parametrize("angle", [0.0, 1e-9, 0.3, 2.0, np.pi - 1e-3, np.pi])
    def test_they_turn_the_start_to_the_ends_by_the_angle_between(
        self, start, across, angle
    ):
        ends = np.cos(angle) * start + np.sin(angle) * across

        R = shortest_rotations(start, ends)

        assert_rotations(R, atol=1e-9)
        assert_allclose(R @ start, ends, atol=1e-9)
        trace = np.trace(R, axis1=1, axis2=2)
        assert_allclose(trace, 1 + 2 * np.cos(angle), atol=1e-9)


class TestRotationAngle:
    def test_agrees_with_scipy(self, rng):
        first = random_rotations(50, rng)
        second = random_rotations(50, rng)
        between = Rotation.from_matrix(first).inv() * Rotation.from_matrix(second)
        expected = np.degrees(between.magnitude())
        assert_allclose(rotation_angle(first, second), expected, rtol=1e-9)

    @pytest.mark.parametrize("degrees", [0.0, 1e-9, 1e-4, 90, 179.999, 180])
    def test_is_exact_at_both_ends(self, degrees, rng):
        start = random_rotations(1, rng)[0]
        axis = np.array([1.0, -2, 0.5])
        turn = rotation_about(axis, np.array(np.radians(degrees)))

        found = rotation_angle(start, start @ turn)

        tolerance = 1e-13 if degrees < 1 else 1e-5
        assert found == pytest.approx(degrees, rel=1e-6, abs=tolerance)
