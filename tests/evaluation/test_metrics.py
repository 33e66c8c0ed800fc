"""Metrics against hand-computed cases, an independent minimiser, and their
symmetries.
"""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

from shapefit.evaluation import metrics
from shapefit.evaluation.metrics import precision, recall
from shapefit.geometry.rotations import random_rotations

SQUARE = np.array([[1.0, -1, 0, 0], [0, 0, 1, -1], [0, 0, 0, 0]])
MIRROR = np.diag([1.0, 1.0, -1.0])


def moved(shapes, rng):
    n = len(shapes)
    scale = rng.uniform(0.1, 10, n)[:, None, None]
    return scale * (random_rotations(n, rng) @ shapes) + rng.standard_normal((n, 3, 1))


@pytest.fixture
def truth(rng):
    return rng.standard_normal((20, 3, 8))


@pytest.fixture
def estimate(truth, rng):
    return truth + 0.3 * rng.standard_normal(truth.shape)


def best_distance(source, target, turn):
    """Least squares by a general minimiser, then the mean distance it leaves."""

    def move(v):
        R = Rotation.from_rotvec(v[:3]).as_matrix() if turn else np.eye(3)
        return np.exp(v[3]) * R @ source + v[4:, None]

    starts = Rotation.random(8, rng=0).as_rotvec() if turn else np.zeros((1, 3))
    runs = [
        minimize(
            lambda v: ((move(v) - target) ** 2).sum(), np.r_[r, np.zeros(4)], tol=1e-12
        )
        for r in starts
    ]
    best = min(runs, key=lambda run: run.fun)
    return np.linalg.norm(move(best.x) - target, axis=0).mean()


class TestSimilarity:
    def test_hand_computed(self):
        # Onto a unit square the doubled square fits exactly; pulling one diagonal out
        # to length a = 3, b = 1 leaves s = (a + b) / (a^2 + b^2) = 0.4 and distances
        # 0.2 and 0.6.
        estimate = np.stack([2 * SQUARE, SQUARE * np.array([3, 3, 1, 1])])
        error = metrics.similarity(estimate, np.stack([SQUARE, SQUARE]))
        assert_allclose(error, [0, 0.4], atol=1e-12)
        assert_allclose(
            metrics.expected(SQUARE[None] / 9, SQUARE[None], error[1:]), 3.6
        )

    def test_ignores_any_similarity_of_the_estimate(self, estimate, truth, rng):
        error = metrics.similarity(estimate, truth)
        assert_allclose(metrics.similarity(moved(estimate, rng), truth), error)
        assert error.min() > 0.1

    def test_does_not_forgive_a_reflection(self, truth):
        assert metrics.similarity(truth, truth).max() < 1e-12
        assert metrics.similarity(MIRROR @ truth, truth).min() > 0.05

    def test_agrees_with_a_general_minimiser(self, estimate, truth):
        estimate, truth = estimate[:5], truth[:5]
        expected = [
            best_distance(*pair, turn=True)
            for pair in zip(estimate, truth, strict=True)
        ]
        assert_allclose(metrics.similarity(estimate, truth), expected, rtol=1e-5)

    @pytest.mark.parametrize("side", ["estimate", "truth"])
    def test_leaves_out_landmarks_that_one_side_lacks(self, estimate, truth, side):
        expected = metrics.similarity(estimate[:, :, 2:], truth[:, :, 2:])
        lacking = {"estimate": estimate.copy(), "truth": truth.copy()}
        lacking[side][:, :, :2] = np.nan
        assert_allclose(metrics.similarity(**lacking), expected)


class TestCamera:
    def test_hand_computed(self):
        # A quarter turn about z takes the truth to the camera.
        quarter = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
        estimate = 0.5 * quarter @ SQUARE + np.array([[7.0], [8], [9]])
        error = metrics.camera(estimate[None], SQUARE[None], quarter[None])
        assert_allclose(error, [0], atol=1e-12)
        wrong = metrics.camera(estimate[None], SQUARE[None], np.eye(3)[None])
        # Unturned <e, x> = 0: the best scale is 0, and every landmark is 1 from the
        # centroid.
        assert_allclose(wrong, [1], atol=1e-12)

    def test_agrees_with_a_general_minimiser(self, estimate, truth, rng):
        R = random_rotations(len(truth), rng)
        expected = [
            best_distance(R_j @ e, R_j @ x, turn=False)
            for e, x, R_j in zip(estimate, truth, R, strict=True)
        ]
        assert_allclose(metrics.camera(R @ estimate, truth, R), expected, rtol=1e-5)

    def test_an_inverted_estimate_is_not_flipped_by_a_negative_scale(self):
        error = metrics.camera(-SQUARE[None], SQUARE[None], np.eye(3)[None])
        assert_allclose(error, [1])


class TestReprojection:
    def test_hand_computed(self):
        observed = np.array([[[0.0, 1, np.nan], [0, 0, np.nan]]])
        fitted = np.array([[[3.0, 1, 50], [4, 0, 50]]])
        assert_allclose(metrics.reprojection(fitted, observed), [5 / np.sqrt(2)])


class TestTruthScale:
    def test_is_that_of_the_landmarks_on_both_sides(self, estimate, truth):
        """What the estimate lacks is not judged, and may lie far away."""
        truth[:, :, 2] = 50.0
        estimate[:, :, 2] = np.nan
        both = np.delete(truth, 2, axis=2)
        expected = both.std(axis=2).mean(axis=1)
        assert_allclose(metrics.truth_scale(estimate, truth), expected)

    def test_true_landmarks_on_one_point_have_no_scale(self, truth):
        one = np.full_like(truth, -0.1)
        one[..., 0] = np.nextafter(-0.1, 0)  # but for rounding
        assert np.isnan(metrics.truth_scale(truth, one)).all()


def test_boxes_are_given_or_go_around_the_visible_landmarks():
    observed = np.array(
        [
            [[1.0, 4.0, 2.0, np.nan], [7.0, 3.0, 5.0, 9.0]],  # 3 by 4
            [[-6.0, 6.0, 0.0, 0.0], [0.0, 0.0, -5.0, 0.0]],  # 12 by 5
            [[np.nan] * 4] * 2,
            [[np.nan, 7, np.nan, np.nan]] * 2,
        ]
    )
    assert_allclose(metrics.box_diagonal(observed), [5, 13, np.nan, np.nan])
    boxes = np.array([[9.0, 9, 6, 8], [9, 9, 0, 0], [9, 9, np.nan, 1], [0, 0, 3, 4]])
    assert_allclose(metrics.box_diagonal(observed, boxes), [10, np.nan, np.nan, 5])


def test_precision_and_recall_are_shares_of_labelled_and_corrupted():
    labelled = np.array(
        [[1, 1, 1, 0, 0], [1, 0, 0, 0, 0], [0] * 5, [0] * 5, [1, 1, 0, 0, 0]], bool
    )
    corrupted = np.array(
        [[1, 1, 0, 1, 1], [1, 0, 0, 0, 0], [0, 1, 0, 0, 0], [0] * 5, [0] * 5], bool
    )
    nan = np.nan
    assert_array_equal(precision(labelled, corrupted), [2 / 3, 1, nan, nan, 0])
    assert_array_equal(recall(labelled, corrupted), [2 / 4, 1, 0, nan, nan])
