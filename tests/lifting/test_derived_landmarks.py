"""Feet hang on ankles and move nothing else; rows of weights of landmarks, and their
error bars.
"""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from shapefit.config.paths import find_dictionary
from shapefit.convex.solver import Status
from shapefit.geometry.rotations import random_rotations
from shapefit.io import read_dictionary
from shapefit.lifting.derived_landmarks import (
    PAIRS,
    combine_landmarks,
    place_dependents,
)
from shapefit.lifting.estimate import PosteriorEstimate
from shapefit.lifting.lift import Lifting
from shapefit.records import Landmarks
from tests.gaussians import covariance_of_root
from tests.pipelines.fitted import fit_images
from tests.points import transpose, with_noise

FEET = slice(15, 21)
OTHER_JOINTS = slice(0, 15)


@pytest.fixture(scope="module")
def people():
    """The dictionary with feet, without hands and spine."""
    whole = read_dictionary(find_dictionary("people"))
    return whole.drop_unmarked(("rtoe", "ltoe"))


@pytest.fixture
def images(people, rng):
    """Bodies of the prior, one of each component, seen from all sides."""
    n = 8
    prior = people.prior
    means = prior.means[:n]
    covariances = prior.covariances[:n]
    nothing = np.zeros(covariances.shape[1])
    deviations = [rng.multivariate_normal(nothing, C) for C in covariances]
    bodies = means + np.reshape(deviations, means.shape)
    in_camera = random_rotations(n, rng) @ bodies
    points = 100 * in_camera[:, :2]
    return Landmarks(
        transpose(points),
        landmark_names=people.landmark_names,
        items=tuple(f"image{i}" for i in range(n)),
    )


@pytest.fixture
def lift(tmp_path):
    def lift(images, **keys):
        keys |= {"method": "posterior"}
        fit, *_ = fit_images(tmp_path, images, "people", **keys)
        return fit

    return lift


def test_feet_move_no_other_joint(images, lift):
    moved = images.landmarks.copy()
    moved[:, FEET] += 30

    found = lift(images)
    other = lift(images.with_points(moved))

    assert_array_equal(other.shapes[:, OTHER_JOINTS], found.shapes[:, OTHER_JOINTS])
    assert_array_equal(other.shape_sd[:, OTHER_JOINTS], found.shape_sd[:, OTHER_JOINTS])
    change = np.abs(found.shapes - other.shapes)[:, FEET, :2]
    assert (change.mean(axis=(1, 2)) > 3).all()


class TestFoot:
    """A foot of three landmarks beside two others and the ankle on which it hangs.

    The judge knows all unknowns at once: the foot (9), and the noise of the four
    landmarks (8) in x and in y, those of the foot before the ankle.
    """

    P = 6
    ANKLE = 1
    FOOT = (3, 4, 5)
    RESIDUAL_VARIANCE = 0.02

    @pytest.fixture
    def rng(self):
        return np.random.default_rng(0)

    @pytest.fixture
    def foot(self):
        """Places of its coordinates among those of all landmarks."""
        start_of_axis = self.P * np.arange(3)
        return np.add.outer(start_of_axis, self.FOOT).ravel()

    @pytest.fixture
    def rest(self, foot):
        """Places of the other coordinates."""
        return np.setdiff1d(np.arange(3 * self.P), foot)

    @pytest.fixture
    def covariance(self, rng, foot, rest):
        """Of all coordinates; the foot says nothing of the rest."""
        A = rng.standard_normal((3 * self.P, 3 * self.P))
        C = 0.02 * A @ A.T / self.P
        C[np.ix_(rest, foot)] = 0.0
        C[np.ix_(foot, rest)] = 0.0
        return C

    @pytest.fixture
    def shapes(self, covariance, rng):
        return rng.standard_normal((1, 3, self.P))

    @pytest.fixture
    def landmarks(self, shapes, rng):
        return rng.standard_normal((1, 2, self.P))

    @pytest.fixture
    def placed(self, covariance, shapes, landmarks):
        """The lifting once the foot is placed."""
        estimate = PosteriorEstimate(
            shapes=shapes,
            translation=np.zeros((1, 2)),
            rotation=np.eye(3)[None],
            objective=np.zeros(1),
            residual=np.zeros(1),
            iterations=np.ones(1, int),
            status=(Status.CONVERGED,),
            deviation=np.ones((1, 3, self.P)),
            correlation=np.zeros((1, 3, self.P), np.float32),
            log_evidence=np.zeros(1),
            inlier_probability=np.ones((1, self.P)),
            squared_mahalanobis=np.zeros(1),
            covariance=covariance[None],
        )
        lifting = Lifting(
            shapes=shapes,
            landmarks_fitted=shapes[:, :2],
            translation=np.zeros((1, 2)),
            scale=np.ones(1),
            problem=None,
            estimate=estimate,
            failures={},
        )
        visible = np.ones((1, self.P), bool)
        depends_on = np.full(self.P, -1)
        depends_on[list(self.FOOT)] = self.ANKLE
        return place_dependents(
            lifting, landmarks, visible, depends_on, self.RESIDUAL_VARIANCE
        )

    @pytest.fixture
    def judge(self, covariance, foot):
        """Gain (9, 6) of the foot, and its covariance about the ankle (9, 9)."""
        prior = np.zeros((17, 17))
        prior[:9, :9] = covariance[np.ix_(foot, foot)]
        prior[9:, 9:] = self.RESIDUAL_VARIANCE * np.eye(8)
        H = np.zeros((6, 17))
        H[:, :6] = np.eye(6)
        H[:, 9:15] = np.eye(6)
        H[:3, 15] = -1.0
        H[3:, 16] = -1.0
        gain = prior @ H.T @ np.linalg.inv(H @ prior @ H.T)
        posterior = prior - gain @ H @ prior
        return gain[:9], posterior[:9, :9]

    def test_it_moves_by_what_is_seen_of_it_beside_its_ankle(
        self, placed, judge, shapes, landmarks
    ):
        gain, _ = judge
        away = (landmarks - shapes[:, :2])[0]
        visible = away[:, list(self.FOOT)] - away[:, [self.ANKLE]]
        step = (gain @ visible.ravel()).reshape(3, 3)

        for points in (placed.shapes, placed.estimate.shapes):
            moved_by = (points - shapes)[0, :, list(self.FOOT)].T
            assert_allclose(moved_by, step, rtol=1e-4, atol=1e-6)

    def test_its_bars_hold_where_the_ankle_is(self, placed, judge, covariance, foot):
        gain, about_ankle = judge
        axis_of_row = np.repeat([0, 1], 3)
        ankle = self.ANKLE + self.P * axis_of_row
        ankle_covariance = covariance[np.ix_(ankle, ankle)]
        expected = about_ankle + gain @ ankle_covariance @ gain.T

        found = placed.estimate.covariance[0][np.ix_(foot, foot)]

        assert_allclose(found, expected, rtol=1e-4, atol=1e-6)


class TestRowsOfWeights:
    """Error bars of landmarks that rows of weights make of others are those of samples:
    points drawn with a covariance of all landmarks, seen through the rows.
    """

    N = 2
    P = 5
    DRAWS = 40_000

    @pytest.fixture
    def rows(self, rng):
        return rng.standard_normal((3, self.P))

    @pytest.fixture
    def root(self, rng, rows):
        return rng.standard_normal((self.N, 3 * self.P, 3 * self.P))

    @pytest.fixture
    def mean(self, rng, root):
        return rng.standard_normal((self.N, 3, self.P))

    @pytest.fixture
    def apart(self):
        """Deviations that the rows themselves have; those of the second are large."""
        return np.array([0.0, 6.0, 0.0])

    @pytest.fixture
    def combined(self, rows, root, mean, apart):
        return combine_landmarks(rows, mean, covariance_of_root(root), apart)

    @pytest.fixture
    def samples(self, rng, rows, root, mean, apart):
        """Points (n, draws, 3, q)."""
        size = (self.N, self.DRAWS, 3 * self.P)
        errors = np.einsum("nij,nsj->nsi", root, rng.standard_normal(size))
        shapes = mean[:, None] + errors.reshape(self.N, self.DRAWS, 3, self.P)
        points = shapes @ rows.T
        return with_noise(points, apart, rng)

    def test_points_are_their_means(self, combined, samples):
        assert_allclose(samples.mean(axis=1), combined.points, atol=0.2)

    def test_deviations_are_theirs(self, combined, samples):
        assert_allclose(samples.std(axis=1), combined.deviation, rtol=0.03)

    @pytest.mark.parametrize("pair", range(3))
    @pytest.mark.parametrize("image", range(N))
    def test_correlations_are_theirs(self, combined, samples, pair, image):
        a, b = PAIRS[pair]
        x = samples[image, :, a]
        y = samples[image, :, b]
        expected = [np.corrcoef(x[:, j], y[:, j])[0, 1] for j in range(x.shape[1])]
        assert_allclose(combined.correlation[image, pair], expected, atol=0.03)
