"""Feet hang on ankles and move nothing else; rows of weights of landmarks, and their
error bars.
"""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from shapefit.config.paths import find_dictionary
from shapefit.convex.solver import Status
from shapefit.io import read_dictionary
from shapefit.lifting.derived_landmarks import (
    PAIRS,
    combine_landmarks,
    place_dependents,
)
from shapefit.lifting.estimate import PosteriorEstimate
from shapefit.lifting.lift import Lifting
from shapefit.records import Landmarks
from tests.pipelines.fitted import fit_images

FEET = slice(15, 21)


@pytest.fixture(scope="module")
def people():
    """The dictionary with feet, without hands and spine."""
    return read_dictionary(find_dictionary("people")).marked(("rtoe", "ltoe"))


@pytest.fixture
def images(people, rng):
    """Bodies of the prior, seen from all sides."""
    n, p = 8, len(people.landmark_names)
    prior = people.prior
    drawn = prior.means[:n] + np.stack(
        [
            rng.multivariate_normal(np.zeros(3 * p), C).reshape(3, p)
            for C in prior.covariances[:n]
        ]
    )
    turn = np.linalg.qr(rng.standard_normal((n, 3, 3)))[0]
    turn[:, :, 0] *= np.linalg.det(turn)[:, None]
    return Landmarks(
        (100 * (turn @ drawn)[:, :2]).swapaxes(1, 2),
        landmark_names=people.landmark_names,
        items=tuple(f"image{i}" for i in range(n)),
    )


@pytest.fixture
def lift(tmp_path):
    def lift(images, **keys):
        keys |= {"method": "posterior"}
        return fit_images(tmp_path, images, "people", **keys)[0]

    return lift


def test_feet_move_no_other_joint(images, lift):
    moved = images.as_columns().copy()
    moved[..., FEET] += 30
    found, other = lift(images), lift(images.replaced(landmarks=moved.swapaxes(1, 2)))
    assert_array_equal(other.shapes[:, :15], found.shapes[:, :15])
    assert_array_equal(other.shape_sd[:, :15], found.shape_sd[:, :15])
    assert (
        np.abs(found.shapes - other.shapes)[:, FEET, :2].mean(axis=(1, 2)) > 3
    ).all()


def test_the_noise_of_an_ankle_is_shared_by_its_foot():
    """Against all unknowns at once: the foot (9), and the noise of four landmarks
    (8).
    """
    rng = np.random.default_rng(0)
    p, residual_variance, feet, ankle = 6, 0.02, [3, 4, 5], 1
    A = rng.standard_normal((3 * p, 3 * p))
    C = 0.02 * A @ A.T / p
    foot = np.concatenate([np.array(feet) + p * axis for axis in range(3)])
    rest = np.setdiff1d(np.arange(3 * p), foot)
    C[np.ix_(rest, foot)] = C[np.ix_(foot, rest)] = (
        0.0  # the foot says nothing of the rest
    )
    shapes, landmarks = rng.standard_normal((1, 3, p)), rng.standard_normal((1, 2, p))
    estimate = PosteriorEstimate(
        shapes=shapes,
        translation=np.zeros((1, 2)),
        rotation=np.eye(3)[None],
        objective=np.zeros(1),
        residual=np.zeros(1),
        iterations=np.ones(1, int),
        status=(Status.CONVERGED,),
        deviation=np.ones((1, 3, p)),
        correlation=np.zeros((1, 3, p), np.float32),
        log_evidence=np.zeros(1),
        inlier_probability=np.ones((1, p)),
        squared_mahalanobis=np.zeros(1),
        covariance=C[None],
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
    depends_on = np.array([-1, -1, -1, ankle, ankle, ankle])
    found = place_dependents(
        lifting, landmarks, np.ones((1, p), bool), depends_on, residual_variance
    )

    prior = np.zeros((17, 17))
    prior[:9, :9] = C[np.ix_(foot, foot)]
    # of the three landmarks in x, in y; of the ankle in x, y
    prior[9:, 9:] = residual_variance * np.eye(8)
    H = np.zeros((6, 17))
    H[:, :6], H[:, 9:15] = np.eye(6), np.eye(6)
    H[:3, 15] = H[3:, 16] = -1.0
    gain = prior @ H.T @ np.linalg.inv(H @ prior @ H.T)
    away = (landmarks - shapes[:, :2])[0]
    visible = (away[:, feet] - away[:, [ankle]]).ravel()
    step = (gain @ visible)[:9].reshape(3, 3)
    for points in (found.shapes, found.estimate.shapes):
        assert_allclose((points - shapes)[0][:, feet], step, rtol=1e-4, atol=1e-6)
    exact = (prior - gain @ H @ prior)[:9, :9]
    K = gain[:9]
    at = np.zeros((6, len(rest)))
    for row in range(6):
        at[row, list(rest).index(ankle + p * (row // 3))] = 1.0
    moved = K @ at @ C[np.ix_(rest, rest)] @ at.T @ K.T
    bars = found.estimate.covariance[0][np.ix_(foot, foot)]  # and where the ankle is
    assert_allclose(bars, exact + moved, rtol=1e-4, atol=1e-6)


def test_error_bars_of_rows_are_those_of_samples(rng):
    """Planted: points drawn with a covariance of all landmarks, seen through the
    rows.
    """
    n, p, q = 2, 5, 3
    rows = rng.standard_normal((q, p))
    root = rng.standard_normal((n, 3 * p, 3 * p))
    covariance = root @ root.swapaxes(1, 2)
    mean, apart = rng.standard_normal((n, 3, p)), np.array([0.0, 6.0, 0.0])
    found = combine_landmarks(rows, mean, covariance, apart)
    draws = np.einsum("nij,nsj->nsi", root, rng.standard_normal((n, 40_000, 3 * p)))
    points = (mean[:, None] + draws.reshape(n, -1, 3, p)) @ rows.T
    points += apart * rng.standard_normal(points.shape)
    assert_allclose(points.mean(axis=1), found.points, atol=0.2)
    assert_allclose(points.std(axis=1), found.deviation, rtol=0.03)
    for row, (a, b) in enumerate(PAIRS):
        for image in range(n):
            for j in range(q):
                own = np.corrcoef(points[image, :, a, j], points[image, :, b, j])[0, 1]
                assert abs(own - found.correlation[image, row, j]) < 0.03
