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
from tests.points import resized, with_noise

NAN = np.nan
SQUARE = np.array([[1.0, -1, 0, 0], [0, 0, 1, -1], [0, 0, 0, 0]])
MIRROR = np.diag([1.0, 1.0, -1.0])


def moved(shapes, rng):
    """Apply a random similarity to each shape."""
    n = len(shapes)
    scale = rng.uniform(0.1, 10, n)
    turned = random_rotations(n, rng) @ shapes
    return resized(turned, scale) + rng.standard_normal((n, 3, 1))


@pytest.fixture
def truth(rng):
    return rng.standard_normal((20, 3, 8))


@pytest.fixture
def estimate(truth, rng):
    return with_noise(truth, 0.3, rng)


def best_distance(source, target, turn):
    """Least squares by a general minimiser, then the mean distance it leaves.

    It moves the source by a scale and a translation, and turns it if asked.
    """

    def move(v):
        R = Rotation.from_rotvec(v[:3]).as_matrix() if turn else np.eye(3)
        return np.exp(v[3]) * R @ source + v[4:, None]

    def sum_of_squares(v):
        return ((move(v) - target) ** 2).sum()

    turns = Rotation.random(8, rng=0).as_rotvec() if turn else np.zeros((1, 3))
    starts = np.pad(turns, ((0, 0), (0, 4)))
    runs = [minimize(sum_of_squares, start, tol=1e-12) for start in starts]
    best = min(runs, key=lambda run: run.fun)
    return np.linalg.norm(move(best.x) - target, axis=0).mean()


class TestSimilarity:
    @pytest.mark.parametrize(
        ("estimate", "error"),
        [
            pytest.param(2 * SQUARE, 0, id="a square of twice the size fits"),
            pytest.param(
                SQUARE * [3, 3, 1, 1], 0.4, id="one diagonal is pulled to length 3"
            ),
        ],
    )
    def test_hand_computed(self, estimate, error):
        """A diagonal of length a = 3 beside b = 1 leaves s = (a + b) / (a^2 + b^2) =
        0.4 and distances 0.2 and 0.6.
        """
        found = metrics.similarity_error(estimate[None], SQUARE[None])
        assert_allclose(found, [error], atol=1e-12)

    def test_an_expected_error_is_in_the_unit_of_the_truth(self):
        truth = SQUARE[None]
        found = metrics.convert_expected_error(truth / 9, truth, np.array([0.4]))
        assert_allclose(found, 3.6)

    def test_ignores_any_similarity_of_the_estimate(self, estimate, truth, rng):
        error = metrics.similarity_error(estimate, truth)
        assert error.min() > 0.1
        assert_allclose(metrics.similarity_error(moved(estimate, rng), truth), error)

    def test_the_truth_has_no_error(self, truth):
        assert metrics.similarity_error(truth, truth).max() < 1e-12

    def test_does_not_forgive_a_reflection(self, truth):
        mirrored = MIRROR @ truth
        assert metrics.similarity_error(mirrored, truth).min() > 0.05

    def test_agrees_with_a_general_minimiser(self, estimate, truth):
        pairs = zip(estimate[:5], truth[:5], strict=True)
        expected = [best_distance(*pair, turn=True) for pair in pairs]
        error = metrics.similarity_error(estimate[:5], truth[:5])
        assert_allclose(error, expected, rtol=1e-5)

    @pytest.mark.parametrize("side", ["estimate", "truth"])
    def test_leaves_out_landmarks_that_one_side_lacks(self, estimate, truth, side):
        others = np.s_[:, :, 2:]
        expected = metrics.similarity_error(estimate[others], truth[others])
        lacking = {"estimate": estimate.copy(), "truth": truth.copy()}
        lacking[side][:, :, :2] = NAN
        assert_allclose(metrics.similarity_error(**lacking), expected)


QUARTER_TURN = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
"""About z."""


def camera_error(estimate, truth, rotation):
    """Return the error of one image."""
    (error,) = metrics.camera_error(estimate[None], truth[None], rotation[None])
    return error


class TestCamera:
    @pytest.fixture
    def turned(self):
        """Half a square, a quarter turn about z away, and moved."""
        shift = np.array([[7.0], [8], [9]])
        return 0.5 * QUARTER_TURN @ SQUARE + shift

    def test_the_turn_of_the_truth_to_the_camera_leaves_no_error(self, turned):
        error = camera_error(turned, SQUARE, QUARTER_TURN)
        assert error == pytest.approx(0, abs=1e-12)

    def test_without_it_every_landmark_is_1_from_the_centroid(self, turned):
        """Unturned <e, x> = 0: the best scale is 0."""
        error = camera_error(turned, SQUARE, np.eye(3))
        assert error == pytest.approx(1, abs=1e-12)

    def test_agrees_with_a_general_minimiser(self, estimate, truth, rng):
        R = random_rotations(len(truth), rng)
        in_camera = R @ estimate
        pairs = zip(in_camera, R @ truth, strict=True)
        expected = [best_distance(*pair, turn=False) for pair in pairs]
        assert_allclose(metrics.camera_error(in_camera, truth, R), expected, rtol=1e-5)

    def test_an_inverted_estimate_is_not_flipped_by_a_negative_scale(self):
        error = camera_error(-SQUARE, SQUARE, np.eye(3))
        assert error == pytest.approx(1, rel=1e-7)


class TestReprojection:
    def test_hand_computed(self):
        """The root mean square of 5 and 0; the third landmark is unseen."""
        observed = np.array([[[0.0, 1, NAN], [0, 0, NAN]]])
        fitted = np.array([[[3.0, 1, 50], [4, 0, 50]]])
        error = metrics.reprojection(fitted, observed)
        assert_allclose(error, [5 / np.sqrt(2)])


class TestTruthScale:
    def test_is_that_of_the_landmarks_on_both_sides(self, estimate, truth):
        """What the estimate lacks is not judged, and may lie far away."""
        truth[:, :, 2] = 50.0
        estimate[:, :, 2] = NAN
        on_both_sides = np.delete(truth, 2, axis=2)
        expected = on_both_sides.std(axis=2).mean(axis=1)
        assert_allclose(metrics.truth_scale(estimate, truth), expected)

    def test_true_landmarks_on_one_point_have_no_scale(self, truth):
        on_one_point = np.full_like(truth, -0.1)
        on_one_point[..., 0] = np.nextafter(-0.1, 0)  # but for rounding
        assert np.isnan(metrics.truth_scale(truth, on_one_point)).all()


class TestBoxDiagonal:
    OBSERVED = np.array(
        [
            [[1.0, 4.0, 2.0, NAN], [7.0, 3.0, 5.0, 9.0]],  # 3 by 4
            [[-6.0, 6.0, 0.0, 0.0], [0.0, 0.0, -5.0, 0.0]],  # 12 by 5
            [[NAN] * 4] * 2,
            [[NAN, 7, NAN, NAN]] * 2,
        ]
    )

    def test_a_box_goes_around_the_visible_landmarks(self):
        diagonal = metrics.box_diagonal(self.OBSERVED)
        assert_allclose(diagonal, [5, 13, NAN, NAN])

    def test_a_box_of_the_file_goes_before(self):
        """A box without extent, or of which a side is unknown, has no diagonal."""
        boxes = np.array([[9.0, 9, 6, 8], [9, 9, 0, 0], [9, 9, NAN, 1], [0, 0, 3, 4]])
        diagonal = metrics.box_diagonal(self.OBSERVED, boxes)
        assert_allclose(diagonal, [10, NAN, NAN, 5])


@pytest.mark.parametrize(
    ("labelled", "corrupted", "precise", "recalled"),
    [
        ([1, 1, 1, 0, 0], [1, 1, 0, 1, 1], 2 / 3, 2 / 4),
        ([1, 0, 0, 0, 0], [1, 0, 0, 0, 0], 1, 1),
        ([0, 0, 0, 0, 0], [0, 1, 0, 0, 0], NAN, 0),
        ([0, 0, 0, 0, 0], [0, 0, 0, 0, 0], NAN, NAN),
        ([1, 1, 0, 0, 0], [0, 0, 0, 0, 0], 0, NAN),
    ],
)
def test_precision_and_recall_are_shares_of_labelled_and_corrupted(
    labelled, corrupted, precise, recalled
):
    labels = np.array([labelled], bool)
    corruption = np.array([corrupted], bool)
    assert_array_equal(precision(labels, corruption), [precise])
    assert_array_equal(recall(labels, corruption), [recalled])
