"""Rules over what a result stores of its error, and the error that is expected."""

import numpy as np
import pytest

from shapefit.convex.solver import Status
from shapefit.evaluation.metrics import similarity
from shapefit.lifting.trust import (
    MEASURED_ERROR_SHARE,
    contradicts,
    expected_error,
    find_reasons,
    median_distance,
)

CUBE = np.array([[1, -1, 1, -1], [1, 1, -1, -1], [1, -1, -1, 1]], dtype=float)
"""Four landmarks whose coordinates have variance 1."""

GOOD = {
    "shape": CUBE,
    "expected": 0.1,
    "seen": 10,
    "p_value": 0.5,
    "distance": 0.2,
    "status": Status.CONVERGED,
}


def reasons(**changes) -> str:
    case = {name: np.array([value]) for name, value in (GOOD | changes).items()}
    return str(find_reasons(*case.values())[0])


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({}, ""),
        ({"p_value": 0.05, "expected": 0.304}, ""),
        ({"expected": 0.306}, "large expected error"),
        ({"p_value": 0.049}, "implausible landmarks"),
        ({"p_value": np.nan}, ""),
        ({"distance": 0.51}, "far from any training shape"),
        ({"distance": 0.51, "seen": 9}, ""),
        ({"distance": np.nan}, ""),
        ({"seen": 3, "p_value": np.nan}, "too few landmarks seen"),
        ({"status": Status.ITERATION_LIMIT}, "not optimal"),
        ({"shape": np.full((3, 4), np.nan), "p_value": np.nan}, "no shape"),
        ({"shape": np.zeros((3, 4))}, "large expected error"),
        ({"shape": 5 * CUBE, "expected": 1.52}, ""),
        ({"seen": 3, "p_value": 0.0, "expected": 9.0}, "too few landmarks seen"),
    ],
)
def test_the_first_reason_that_holds_is_named(changes, reason):
    assert reasons(**changes) == reason


def test_only_landmarks_that_are_shown_are_measured():
    """A landmark that no image shows is guessed: it makes a shape large and unsure."""
    far_off = np.array([[9.0], [0.0], [0.0]])
    shape = np.concatenate([CUBE, far_off], axis=1)
    case = {**GOOD, "shape": shape, "expected": 0.32}
    values = [np.array([value]) for value in case.values()]
    shown = np.array([True, True, True, True, False])
    assert find_reasons(*values, shown=shown)[0] == "large expected error"
    assert find_reasons(*values)[0] == ""

    covariance = np.diag(np.tile([0.01, 0.01, 0.01, 0.01, 4.0], 3))[None]
    of_shown = expected_error(shape[None], covariance, shown)
    without = np.flatnonzero(np.tile(shown, 3))
    alone = expected_error(CUBE[None], covariance[:, without[:, None], without])
    assert of_shown == pytest.approx(alone)
    assert of_shown < 0.3 * expected_error(shape[None], covariance)


@pytest.mark.parametrize(
    ("kappa", "distance", "visible", "images", "wrong"),
    [
        (1.0, 0.2, 15, 60, False),
        (2.6, 0.2, 15, 60, True),
        (1.0, 0.51, 15, 60, True),
        (1.0, 0.51, 9, 60, False),  # too few landmarks for a start distance
        (np.nan, 0.2, 15, 60, True),
        (1.0, 0.9, 15, 19, False),  # too few images
        (1.0, 0.9, 15, 20, True),
    ],
)
def test_a_file_that_contradicts_the_dictionary(
    kappa, distance, visible, images, wrong
):
    apart = median_distance(np.full(images, distance), np.full(images, visible))
    assert contradicts(kappa, apart, trusted=0.3, doubtful=0.2) == wrong


@pytest.mark.parametrize(
    ("kappa", "trusted", "doubtful", "wrong"),
    [
        (2.6, 0.49, 0.0, True),
        (2.6, 0.5, 0.0, False),  # unlike training, but told apart image by image
        (1.0, 0.09, 0.26, True),  # what is trusted is so by chance
        (1.0, 0.11, 0.26, False),
        (1.0, 0.09, 0.24, False),
    ],
)
def test_what_would_be_trusted_of_a_file_counts(kappa, trusted, doubtful, wrong):
    assert contradicts(kappa, 0.2, trusted, doubtful) == wrong


@pytest.mark.parametrize("kind", ["of all coordinates", "of depths", "a similarity"])
def test_the_expected_error_is_that_of_draws(rng, kind):
    p, draws = 12, 300
    shape = rng.standard_normal((3, p))
    L = 0.05 * rng.standard_normal((3 * p, 3 * p)) / 3
    if kind == "of depths":
        L[: 2 * p] = 0.0
    if kind == "a similarity":
        x, y, z = shape - shape.mean(axis=1, keepdims=True)
        o = np.zeros(p)
        L = 0.02 * np.array([np.r_[o + 1, o, o], np.r_[-y, x, o], np.r_[x, y, z]]).T
    truths = shape + (L @ rng.standard_normal((L.shape[1], draws))).T.reshape(
        draws, 3, p
    )
    found = expected_error(shape[None], (L @ L.T)[None])[0] / MEASURED_ERROR_SHARE
    measured = similarity(np.repeat(shape[None], draws, axis=0), truths).mean()
    assert found == pytest.approx(measured, rel=0.08, abs=2e-3)


def test_what_is_not_finite_has_no_expected_error():
    shapes, covariance = np.ones((2, 3, 4)), np.tile(np.eye(12), (2, 1, 1))
    shapes[0, 0, 0], covariance[1, 0, 0] = np.nan, np.nan
    assert np.isnan(expected_error(shapes, covariance)).all()
