"""Rules over what a result stores of its error, and the error that is expected."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from shapefit.convex.solver import Status
from shapefit.evaluation.metrics import similarity_error
from shapefit.geometry.rotations import random_rotations
from shapefit.lifting import trust
from shapefit.lifting.trust import (
    MEASURED_ERROR_SHARE,
    contradicts_dictionary,
    cover_mirror_image,
    expected_error,
    find_reasons,
    median_distance,
)
from tests.gaussians import deviations_and_correlations, single_gaussian
from tests.lifting.posterior.scenes import FilmedScene, draw_component
from tests.points import centred

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


def reason_of(sides=0.0, *, depth_ambiguity=False, **changes) -> str:
    case = {name: np.array([value]) for name, value in (GOOD | changes).items()}
    options = {"sides": np.array([sides]), "depth_ambiguity": depth_ambiguity}
    (reason,) = find_reasons(*case.values(), **options)
    return str(reason)


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
        ({"sides": 1.0}, ""),
        ({"sides": np.nan}, "left and right change places"),
        ({"sides": np.nan, "expected": 9.0}, "large expected error"),
        ({"depth_ambiguity": True}, "near and far not told apart"),
        ({"depth_ambiguity": True, "expected": 9.0}, "near and far not told apart"),
        ({"depth_ambiguity": True, "p_value": 0.0}, "implausible landmarks"),
    ],
)
def test_the_first_reason_that_holds_is_named(changes, reason):
    assert reason_of(**changes) == reason


class TestLandmarksThatAreShown:
    """They alone are measured.

    A landmark that no image shows is guessed: it makes a shape large and unsure.
    """

    FAR_OFF = np.array([[9.0], [0.0], [0.0]])
    SHAPE = np.concatenate([CUBE, FAR_OFF], axis=1)
    SHOWN = np.array([True, True, True, True, False])

    def test_a_large_shape_forgives_an_error_that_they_do_not(self):
        case = GOOD | {"shape": self.SHAPE, "expected": 0.32}
        values = [np.array([value]) for value in case.values()]
        (reason_for_all,) = find_reasons(*values)
        (reason_for_shown,) = find_reasons(*values, shown=self.SHOWN)
        assert reason_for_all == ""
        assert reason_for_shown == "large expected error"

    def test_the_expected_error_is_theirs(self):
        covariance = np.diag(np.tile([0.01, 0.01, 0.01, 0.01, 4.0], 3))
        coordinates = np.flatnonzero(np.tile(self.SHOWN, 3))
        shown_covariance = covariance[np.ix_(coordinates, coordinates)]

        error_of_all = expected_error(self.SHAPE[None], covariance[None])
        error_of_shown = expected_error(self.SHAPE[None], covariance[None], self.SHOWN)
        alone = expected_error(CUBE[None], shown_covariance[None])

        assert error_of_shown == pytest.approx(alone)
        assert error_of_shown < 0.3 * error_of_all


@pytest.mark.parametrize(
    ("kappa", "distance", "visible", "images", "wrong"),
    [
        (1.0, 0.2, 15, 60, False),
        (2.6, 0.2, 15, 60, True),
        (1.0, 0.51, 15, 60, True),
        (1.0, 0.51, 10, 60, True),
        (1.0, 0.51, 9, 60, False),  # too few landmarks for a start distance
        (np.nan, 0.2, 15, 60, True),
        (1.0, 0.9, 15, 19, False),  # too few images
        (1.0, 0.9, 15, 20, True),
    ],
)
def test_a_file_that_contradicts_the_dictionary(
    kappa, distance, visible, images, wrong
):
    distances = np.full(images, distance)
    apart = median_distance(distances, np.full(images, visible))
    assert (
        contradicts_dictionary(kappa, apart, trusted_share=0.3, doubtful_share=0.2)
        == wrong
    )


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
    assert contradicts_dictionary(kappa, 0.2, trusted, doubtful) == wrong


P = 12
"""Landmarks."""


def errors_of_all_coordinates(shape, rng):
    return 0.05 * rng.standard_normal((3 * P, 3 * P)) / 3


def errors_of_depths(shape, rng):
    root = errors_of_all_coordinates(shape, rng)
    root[: 2 * P] = 0.0
    return root


def errors_of_a_similarity(shape, rng):
    """Along x, about z, and of the size."""
    x, y, z = centred(shape)
    nothing = np.zeros(P)
    shift = np.r_[nothing + 1, nothing, nothing]
    turn = np.r_[-y, x, nothing]
    growth = np.r_[x, y, z]
    return 0.02 * np.stack([shift, turn, growth], axis=1)


@pytest.mark.parametrize(
    "root_of", [errors_of_all_coordinates, errors_of_depths, errors_of_a_similarity]
)
def test_the_expected_error_is_that_of_draws(rng, root_of):
    """Errors have the covariance root root^T."""
    draws = 300
    shape = rng.standard_normal((3, P))
    root = root_of(shape, rng)
    errors = root @ rng.standard_normal((root.shape[1], draws))
    truths = shape + errors.T.reshape(draws, 3, P)
    estimates = np.repeat(shape[None], draws, axis=0)
    measured = similarity_error(estimates, truths).mean()

    (found,) = expected_error(shape[None], (root @ root.T)[None])

    mean = found / MEASURED_ERROR_SHARE
    assert mean == pytest.approx(measured, rel=0.08, abs=2e-3)


def draw_estimates(rng, n):
    """Draw shapes (n, 3, P) and full covariances of their coordinates."""
    shapes = rng.standard_normal((n, 3, P))
    roots = 0.02 * rng.standard_normal((n, 3 * P, 3 * P))
    return shapes, roots @ roots.swapaxes(1, 2)


@pytest.mark.parametrize("at_once", [2, 3, 100])
def test_the_expected_error_of_an_image_does_not_depend_on_others(
    rng, monkeypatch, at_once
):
    monkeypatch.setattr(trust, "IMAGES_AT_ONCE", at_once)
    shapes, covariances = draw_estimates(rng, 7)

    together = expected_error(shapes, covariances)

    rows = [slice(row, row + 1) for row in range(7)]
    alone = [expected_error(shapes[row], covariances[row]) for row in rows]
    assert_allclose(together, np.concatenate(alone))


def test_the_expected_error_turns_moves_and_grows_with_the_shape(rng):
    shapes, covariances = draw_estimates(rng, 3)
    turn = random_rotations(3, rng)
    of_coordinates = np.kron(turn, np.eye(P))
    moved = 2.5 * turn @ shapes + rng.standard_normal((3, 3, 1))
    turned = of_coordinates @ covariances @ of_coordinates.swapaxes(1, 2)

    found = expected_error(moved, 2.5**2 * turned)

    assert_allclose(found, 2.5 * expected_error(shapes, covariances))


def test_what_is_not_finite_has_no_expected_error():
    shapes = np.ones((2, 3, 4))
    covariance = np.tile(np.eye(12), (2, 1, 1))
    shapes[0, 0, 0] = np.nan
    covariance[1, 0, 0] = np.nan
    assert np.isnan(expected_error(shapes, covariance)).all()


@pytest.mark.parametrize("count", [0, 1, 2])
def test_an_alignment_leaves_no_error_of_two_landmarks(count):
    shapes = np.ones((2, 3, 4))
    covariance = np.tile(np.eye(12), (2, 1, 1))
    shown = np.arange(4) < count
    assert np.isnan(expected_error(shapes, covariance, shown)).all()


class TestMirrorImages:
    """Where near and far are not told apart, a shape and its mirror image are equally
    likely.
    """

    N = 4

    @pytest.fixture
    def estimate(self, rng):
        prior = single_gaussian(*draw_component(rng, P, 0.1))
        scene = FilmedScene(prior, self.N, 1e3, 1.0)
        return scene.lift(prior, np.ones((self.N, P))).estimate

    @pytest.fixture
    def expected(self, estimate):
        """The second moments about a shape of a mixture of it and its mirror image."""
        mirror = np.diag(np.repeat([1.0, 1.0, -1.0], P))
        points = centred(estimate.shapes).reshape(self.N, 3 * P)
        away = points @ mirror - points
        C = estimate.covariance
        of_mirror_image = mirror @ C @ mirror + away[:, :, None] * away[:, None]
        return (C + of_mirror_image) / 2

    def test_the_covariance_is_that_of_both(self, estimate, expected):
        covered = cover_mirror_image(estimate)
        assert_allclose(covered.covariance, expected, atol=1e-12)

    def test_so_are_bars_and_correlations(self, estimate, expected):
        covered = cover_mirror_image(estimate)
        blocks = expected.reshape(self.N, 3, P, 3, P)
        of_landmark = np.einsum("naibi->niab", blocks)
        deviation, correlation = deviations_and_correlations(of_landmark)
        assert_allclose(covered.deviation, deviation, rtol=1e-6)
        in_image = covered.correlation[:, 0]
        assert_allclose(in_image, correlation[:, 0], atol=1e-6)
        assert (covered.correlation[:, 1:] == 0).all()

    def test_how_deep_a_shape_stands_does_not_matter(self, estimate, expected):
        deeper = estimate.shapes + np.array([0.0, 0.0, 7.0])[:, None]
        covered = cover_mirror_image(replace(estimate, shapes=deeper))
        assert_allclose(covered.covariance, expected, atol=1e-12)

    def test_the_estimate_itself_stays(self, estimate):
        before = estimate.covariance.copy()
        cover_mirror_image(estimate)
        assert_array_equal(estimate.covariance, before)
