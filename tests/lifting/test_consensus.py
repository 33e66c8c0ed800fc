"""RANSAC over triples: closed-form poses, planted outliers, and what must not change
the labels.
"""

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from shapefit.convex.problem import build_problem
from shapefit.geometry.normalisation import normalise
from shapefit.geometry.rotations import random_rotations
from shapefit.lifting.consensus import find_consensus
from shapefit.lifting.shared_rotation import find_pose
from tests.points import resized, with_noise

P = 30
"""Landmarks."""

N = 70
"""Images."""

THRESHOLD = 0.1
"""Distance of an inlier, in the unit of the shape."""


@pytest.fixture
def shape(rng):
    return normalise(rng.standard_normal((3, P))).points


@pytest.fixture
def posed(shape, rng):
    """Landmarks of the shape at N random poses."""
    size = rng.uniform(5, 200, N)
    T = 300 * rng.standard_normal((N, 2))
    turned = random_rotations(N, rng)[:, :2] @ shape
    return resized(turned, size) + T[..., None]


def extent(landmarks):
    """Return the largest extent of each image along x or y (n, 1, 1)."""
    return np.ptp(landmarks, axis=2).max(axis=1)[:, None, None]


def plant(landmarks, share, rng):
    """Replace a share by points of the bounding box that lie outside every
    tolerance.
    """
    n = len(landmarks)
    order = rng.random((n, P)).argsort(1)
    is_wrong = order < round(share * P)
    low = landmarks.min(axis=2, keepdims=True)
    high = landmarks.max(axis=2, keepdims=True)
    points = rng.uniform(low, high, landmarks.shape)
    distance = np.linalg.norm(points - landmarks, axis=1, keepdims=True)
    is_near = distance < 0.2 * extent(landmarks)
    points = np.where(is_near, landmarks + 0.3 * extent(landmarks), points)
    return np.where(is_wrong[:, None], points, landmarks), is_wrong


def search(landmarks, shape, weights=None, **settings):
    """Return the labels of inliers (n, p)."""
    n, _, p = landmarks.shape
    if weights is None:
        weights = np.ones((n, p))
    seeds = settings.pop("seeds", np.arange(n).astype(np.uint64))
    settings = {"threshold": THRESHOLD, "draws": 500, "max_rounds": 100} | settings
    return find_consensus(landmarks, weights, shape, seeds, **settings)


@pytest.mark.parametrize("share", [0.0, 0.3, 0.5])
def test_planted_outliers_are_found_exactly(posed, shape, share, rng):
    landmarks, is_wrong = plant(posed, share, rng)
    assert_array_equal(search(landmarks, shape), ~is_wrong)


def residuals_of_the_pose(landmarks, shape, weights):
    """Return the distances (n, p) that the pose of weighted landmarks leaves, in the
    unit of the shape.
    """
    problem = build_problem(landmarks, shape[None], 1.0, weights=weights)
    pose = find_pose(problem, shape)
    size = pose.size[:, None]
    away = landmarks - size[..., None] * pose.rotation[:, :2] @ shape
    square = weights[:, None] ** 2
    T = (away * square).sum(axis=2) / square.sum(axis=2)
    return np.linalg.norm(away - T[..., None], axis=1) / size


def test_the_inliers_are_those_of_the_pose_fitted_to_them(posed, shape, rng):
    """With so much noise that the threshold divides the landmarks."""
    landmarks, _ = plant(posed, 0.3, rng)
    spread = np.ptp(landmarks, axis=2, keepdims=True)
    landmarks = with_noise(landmarks, 0.03 * spread, rng)
    weights = rng.uniform(0.5, 1, (N, P))

    is_inlier = search(landmarks, shape, weights)

    inlier_weights = np.where(is_inlier, weights, 0.0)
    residual = residuals_of_the_pose(landmarks, shape, inlier_weights)
    assert_array_equal(residual <= THRESHOLD, is_inlier)
    assert 5 < is_inlier.sum(axis=1).mean() < 20


class TestSameLabels:
    """Labels depend on the image and its seed alone: here so hard that draws decide."""

    @pytest.fixture
    def landmarks(self, posed, rng):
        landmarks, _ = plant(posed, 0.7, rng)
        largest = np.ptp(landmarks, axis=2).max()
        return with_noise(landmarks, 0.02 * largest, rng)

    @pytest.fixture
    def seeds(self, rng):
        return rng.integers(0, 2**63, N).astype(np.uint64)

    @pytest.fixture
    def labels(self, landmarks, shape, seeds):
        return search(landmarks, shape, seeds=seeds, draws=50, threads=1)

    def test_other_seeds_give_other_labels(self, landmarks, shape, seeds, labels):
        others = seeds + np.uint64(1)
        found = search(landmarks, shape, seeds=others, draws=50)
        assert (found != labels).any()

    def test_threads_do_not_matter(self, landmarks, shape, seeds, labels):
        found = search(landmarks, shape, seeds=seeds, draws=50, threads=2)
        assert_array_equal(found, labels)

    def test_the_order_of_images_does_not_matter(
        self, landmarks, shape, seeds, labels, rng
    ):
        order = rng.permutation(N)
        found = search(landmarks[order], shape, seeds=seeds[order], draws=50)
        assert_array_equal(found, labels[order])

    def test_the_other_images_do_not_matter(self, landmarks, shape, seeds, labels):
        one = slice(5, 6)
        found = search(landmarks[one], shape, seeds=seeds[one], draws=50)
        assert_array_equal(found, labels[one])


def test_three_landmarks_in_one_place_are_no_proof(posed, shape, rng):
    """A tiny shape there fits them as exactly as can be, and nothing else."""
    landmarks = posed.copy()
    weights = np.zeros((N, P))
    weights[:, :11] = 1.0
    size = extent(landmarks)
    place = landmarks.mean(axis=2, keepdims=True) + 0.3 * size
    landmarks[:, :, :3] = place + 1e-4 * size * rng.standard_normal((N, 2, 3))

    is_inlier = search(landmarks, shape, weights)

    expected = np.zeros((N, P), bool)
    expected[:, 3:11] = True
    assert_array_equal(is_inlier, expected)


def test_three_visible_landmarks_fit_some_pose(posed, shape):
    weights = np.zeros((1, P))
    weights[0, :3] = 1.0
    is_inlier = search(posed[:1], shape, weights)
    assert_array_equal(is_inlier, weights > 0)


def test_degenerate_images_have_no_inliers(posed, shape):
    landmarks = posed[:4].copy()
    weights = np.ones((4, P))
    weights[0, 2:] = 0.0  # two landmarks
    weights[1] = 0.0
    landmarks[2] = 7.0  # on a point
    landmarks[3, 1] = 2 * landmarks[3, 0]  # on a line

    is_inlier = search(landmarks, shape, weights)

    assert not is_inlier.any()


def test_the_search_stops_by_the_share_of_inliers(posed, shape, rng):
    """More draws than anyone waits for, where the inliers of the first ones decide."""
    landmarks, is_wrong = plant(posed, 0.5, rng)
    is_inlier = search(landmarks, shape, draws=10**12)
    assert_array_equal(is_inlier, ~is_wrong)
