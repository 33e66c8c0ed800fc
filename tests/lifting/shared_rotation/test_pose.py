"""The pose of a known shape: planted, against SciPy from many starts, under hidden landmarks."""

import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

from shapefit.convex.problem import build_problem
from shapefit.geometry.rotations import random_rotations
from shapefit.lifting.shared_rotation import (
    even_views,
    find_pose,
)


@pytest.fixture
def shape(rng):
    return rng.standard_normal((3, 10))


def posed(shape, R, size, T, noise=0.0, rng=None):
    landmarks = size[:, None, None] * R[:, :2] @ shape + T[..., None]
    return landmarks + (noise * rng.standard_normal(landmarks.shape) if noise else 0.0)


def misfits(problem, shape, pose):
    omega = problem.weights[:, None]
    left = problem.landmarks - pose.size[:, None, None] * pose.rotation[:, :2] @ shape
    T = (left * omega**2).sum(-1, keepdims=True) / (omega**2).sum(-1, keepdims=True)
    return 0.5 * (omega**2 * (left - T) ** 2).sum(axis=(1, 2))


@pytest.mark.parametrize("flat", [False, True])
def test_planted_poses_come_back(shape, rng, flat):
    if flat:  # depth reversed, a flat shape has a second pose of the same image
        shape[2] = 0.0
    R, size = random_rotations(200, rng), rng.uniform(0.2, 4, 200)
    T = rng.standard_normal((200, 2))
    problem = build_problem(posed(shape, R, size, T), shape[None], 1.0)
    found = find_pose(problem, shape, even_views(6))
    np.testing.assert_allclose(found.size, size, rtol=1e-7)
    np.testing.assert_allclose(misfits(problem, shape, found), 0.0, atol=1e-12)
    if flat:
        reversed_depth = R * np.array([1.0, 1.0, -1.0])
        reversed_depth[:, 2] *= -1
        nearest = np.minimum(
            np.abs(found.rotation - R).max(axis=(1, 2)),
            np.abs(found.rotation - reversed_depth).max(axis=(1, 2)),
        )
        np.testing.assert_allclose(nearest, 0.0, atol=1e-6)
    else:
        np.testing.assert_allclose(found.rotation, R, atol=1e-6)


def test_scipy_finds_no_better_pose_from_many_starts(shape, rng):
    n = 6
    landmarks = posed(
        shape, random_rotations(n, rng), np.ones(n), np.zeros((n, 2)), noise=0.8, rng=rng
    )
    problem = build_problem(landmarks, shape[None], 1.0, weights=rng.uniform(0.5, 2, (n, 10)))
    found = find_pose(problem, shape, even_views(6))
    ours = misfits(problem, shape, found)

    def residual_square(x, image):
        omega = problem.weights[image]
        left = problem.landmarks[image] - x[3] * Rotation.from_rotvec(x[:3]).as_matrix()[:2] @ shape
        return 0.5 * (omega**2 * (left - x[4:, None]) ** 2).sum()

    for image in range(n):
        best = np.inf
        for start in random_rotations(12, rng):
            x = np.concatenate([Rotation.from_matrix(start).as_rotvec(), [1.0, 0.0, 0.0]])
            best = min(best, minimize(residual_square, x, args=(image,), tol=1e-12).fun)
        assert ours[image] == pytest.approx(best, rel=1e-6)


@pytest.mark.parametrize("count", [1, 2, 6, 24])
def test_views_are_spread_over_the_sphere(count, rng):
    views = even_views(count)
    np.testing.assert_array_equal(views[0], np.eye(3))
    np.testing.assert_allclose(
        views @ views.swapaxes(1, 2), np.broadcast_to(np.eye(3), views.shape), atol=1e-14
    )
    np.testing.assert_allclose(np.linalg.det(views), 1)
    axes = views[:, 2]
    directions = random_rotations(2000, rng)[:, 0]
    farthest = np.degrees(np.arccos((directions @ axes.T).max(axis=1).min()))
    assert farthest < {1: 181, 2: 136, 6: 75, 24: 38}[count]


def test_without_landmarks_there_is_no_pose(shape):
    weights = np.ones((2, 10))
    weights[0] = 0.0
    problem = build_problem(np.stack([shape[:2], shape[:2]]), shape[None], 1.0, weights=weights)
    found = find_pose(problem, shape, even_views(6))
    np.testing.assert_array_equal(np.isnan(found.rotation).all(axis=(1, 2)), [True, False])
    np.testing.assert_allclose(found.size, [0, 1], atol=1e-9)
