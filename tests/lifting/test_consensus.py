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

P, N, THRESHOLD = 30, 70, 0.1


@pytest.fixture
def shape(rng):
    return normalise(rng.standard_normal((3, P))).points


@pytest.fixture
def posed(shape, rng):
    """Landmarks of the shape at N random poses."""
    size, T = rng.uniform(5, 200, N), 300 * rng.standard_normal((N, 2))
    return (
        size[:, None, None] * (random_rotations(N, rng)[:, :2] @ shape) + T[..., None]
    )


def plant(landmarks, share, rng):
    """Replace a share by points of the bounding box that lie outside every
    tolerance.
    """
    wrong = rng.random((len(landmarks), landmarks.shape[2])).argsort(1) < round(
        share * P
    )
    low, high = (f(landmarks, axis=2, keepdims=True) for f in (np.min, np.max))
    points = rng.uniform(low, high, landmarks.shape)
    unit = np.abs(high - low).max(axis=1, keepdims=True)
    near = np.linalg.norm(points - landmarks, axis=1, keepdims=True) < 0.2 * unit
    points = np.where(near, landmarks + 0.3 * unit, points)
    return np.where(wrong[:, None], points, landmarks), wrong


def search(landmarks, shape, weights=None, **settings):
    n, _, p = landmarks.shape
    weights = np.ones((n, p)) if weights is None else weights
    seeds = settings.pop("seeds", np.arange(n).astype(np.uint64))
    settings = {"threshold": THRESHOLD, "draws": 500, "max_rounds": 100} | settings
    return find_consensus(landmarks, weights, shape, seeds, **settings)


@pytest.mark.parametrize("share", [0.0, 0.3, 0.5])
def test_planted_outliers_are_found_exactly(posed, shape, share, rng):
    landmarks, wrong = plant(posed, share, rng)
    assert_array_equal(search(landmarks, shape), ~wrong)


def test_the_inliers_are_those_of_the_pose_fitted_to_them(posed, shape, rng):
    landmarks, _ = plant(posed, 0.3, rng)
    landmarks += (
        0.03 * np.ptp(landmarks, axis=2, keepdims=True) * rng.standard_normal((N, 2, P))
    )
    weights = rng.uniform(0.5, 1, (N, P))
    found = search(landmarks, shape, weights)
    problem = build_problem(
        landmarks, shape[None], 1.0, weights=np.where(found, weights, 0.0)
    )
    pose = find_pose(problem, shape)
    left = landmarks - pose.size[:, None, None] * pose.rotation[:, :2] @ shape
    share = np.where(found, weights**2, 0.0)
    T = (left * share[:, None]).sum(axis=2) / share.sum(axis=1)[:, None]
    residual = np.linalg.norm(left - T[..., None], axis=1) / pose.size[:, None]
    assert_array_equal(residual <= THRESHOLD, found)
    assert 5 < found.sum(axis=1).mean() < 20  # the threshold divides the inliers


def test_labels_depend_neither_on_order_nor_on_threads_nor_on_company(
    posed, shape, rng
):
    landmarks, _ = plant(posed, 0.7, rng)  # so hard that the draws decide
    landmarks += (
        0.02 * np.ptp(landmarks, axis=2).max() * rng.standard_normal(landmarks.shape)
    )
    seeds = rng.integers(0, 2**63, N).astype(np.uint64)
    base = search(landmarks, shape, seeds=seeds, draws=50, threads=1)
    assert (
        search(landmarks, shape, seeds=seeds + np.uint64(1), draws=50) != base
    ).any()
    assert_array_equal(search(landmarks, shape, seeds=seeds, draws=50, threads=2), base)
    order = rng.permutation(N)
    assert_array_equal(
        search(landmarks[order], shape, seeds=seeds[order], draws=50), base[order]
    )
    assert_array_equal(
        search(landmarks[5:6], shape, seeds=seeds[5:6], draws=50), base[5:6]
    )


def test_three_landmarks_in_one_place_are_no_proof(posed, shape, rng):
    """A tiny shape there fits them as exactly as can be, and nothing else."""
    landmarks, weights = posed.copy(), np.zeros((N, P))
    weights[:, :11] = 1.0
    size = np.ptp(landmarks, axis=2).max(axis=1)[:, None, None]
    place = landmarks.mean(axis=2, keepdims=True) + 0.3 * size
    landmarks[:, :, :3] = place + 1e-4 * size * rng.standard_normal((N, 2, 3))
    expected = np.tile((np.arange(P) >= 3) & (np.arange(P) < 11), (N, 1))
    assert_array_equal(search(landmarks, shape, weights), expected)


def test_degenerate_images(posed, shape):
    landmarks, weights = posed[:5].copy(), np.ones((5, P))
    weights[0, 3:] = 0.0  # three landmarks fit some pose
    weights[1, 2:] = 0.0
    landmarks[2] = 7.0
    landmarks[3, 1] = 2 * landmarks[3, 0]  # on a line
    weights[4] = 0.0
    found = search(landmarks, shape, weights)
    assert_array_equal(found[0], weights[0] > 0)
    assert not found[1:].any()


def test_the_search_stops_by_the_share_of_inliers(posed, shape, rng):
    """More draws than anyone waits for, where the inliers of the first ones decide."""
    landmarks, wrong = plant(posed, 0.5, rng)
    assert_array_equal(search(landmarks, shape, draws=10**12), ~wrong)
