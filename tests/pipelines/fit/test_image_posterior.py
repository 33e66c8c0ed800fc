"""`posterior` through `fit`: what is seen of an image, error bars, trust, cameras."""

from dataclasses import replace
from types import SimpleNamespace

import h5py
import numpy as np
import pytest

from shapefit.config.paths import find_dictionary
from shapefit.dictionary.mixture import Mixture
from shapefit.io import read_dictionary, write_dictionary
from shapefit.lifting import trust
from shapefit.lifting.posterior.p_value import with_p_value_table
from shapefit.pipelines.fit.image_posterior import ImagePosterior, find_at_border
from shapefit.records import Landmarks
from tests.pipelines.fitted import failures

# Landmarks at a border of the image

SIZE = (640.0, 480.0)

NAMES = ("hip", "knee", "ankle", "head")

EDGES = np.array([[0, 1], [1, 2], [0, 3]])

AT_THE_LOWER_BORDER = [(300, 400), (300, 478), (320, 479), (300, 100)]

HIDDEN_AT_BORDERS = {
    "neighbours": (AT_THE_LOWER_BORDER, ["knee", "ankle"]),
    "three at the left": (
        [(3, 200), (2, 300), (300, 400), (5, 100)],
        ["hip", "knee", "head"],
    ),
    "within 6.4 pixels": (
        [(634, 200), (634, 300), (300, 400), (300, 100)],
        ["hip", "knee"],
    ),
    "a neighbour in the image": (
        [(300, 400), (300, 470), (320, 479), (300, 100)],
        [],
    ),
    "no neighbours": ([(300, 479), (300, 470), (320, 479), (300, 100)], []),
    "of other sides": ([(3, 200), (638, 300), (300, 400), (300, 100)], []),
}
"""Where landmarks are, and those that are not seen."""


def names_at_border(points, size=None, names_of_edges=NAMES, **columns):
    """Return the landmarks of an image that are taken to lie beyond its border."""
    images = Landmarks(
        np.array([points], float),
        landmark_names=NAMES,
        items=("a",),
        file_extras=columns,
    )
    dictionary = SimpleNamespace(edges=EDGES, landmark_names=names_of_edges)
    (marked,) = find_at_border(images, dictionary, size)
    return [name for name, at_border in zip(NAMES, marked, strict=True) if at_border]


@pytest.mark.parametrize(
    ("points", "hidden"), HIDDEN_AT_BORDERS.values(), ids=HIDDEN_AT_BORDERS
)
def test_neighbours_at_one_border_are_not_seen(points, hidden):
    assert names_at_border(points, SIZE) == hidden


@pytest.mark.parametrize(
    ("points", "hidden"), HIDDEN_AT_BORDERS.values(), ids=HIDDEN_AT_BORDERS
)
def test_the_size_of_the_image_may_come_from_the_file(points, hidden):
    assert names_at_border(points, image_size=np.array(SIZE)) == hidden


def test_an_image_of_unknown_size_has_no_border():
    assert names_at_border(AT_THE_LOWER_BORDER) == []


def test_landmarks_without_edges_have_no_neighbours():
    assert names_at_border(AT_THE_LOWER_BORDER, SIZE, tuple("abcd")) == []


# Confidence


def test_a_confidence_of_the_least_that_counts_is_seen():
    images = Landmarks(
        np.ones((1, 5, 2)),
        landmark_names=tuple("abcde"),
        items=("0",),
        confidence=np.array([[0.0, 0.29, 0.3, 0.31, 7.0]]),
    )
    people = read_dictionary(find_dictionary("people"))
    posterior = ImagePosterior(dictionary=people, min_confidence=0.3)
    assert posterior.weigh(images).tolist() == [[0, 0, 1, 1, 1]]


# Error bars and trust


@pytest.fixture
def with_prior(dictionary, atoms, rng):
    """The dictionary with a prior of two Gaussians about its atoms."""
    B = 0.1 * rng.standard_normal((2, 30, 30))
    C = B @ np.matrix_transpose(B) / 30 + 0.01 * np.eye(30)
    means = 5 * np.stack([atoms[:3].mean(axis=0), atoms[3:].mean(axis=0)])
    prior = Mixture(np.array([0.7, 0.3]), means, C)
    known = read_dictionary(dictionary)
    write_dictionary(dictionary, with_p_value_table(replace(known, prior=prior)))
    return dictionary


@pytest.fixture
def lift(fit, with_prior):
    """Fit images by their posterior; return the result and the outcomes."""

    def lift(images, focal="none", **keys):
        keys = {"camera": {"focal": focal}, **keys}
        return fit(with_prior, images, method="posterior", **keys)

    return lift


WITH_COVARIANCE = {"save": {"covariance": True}}


@pytest.fixture
def covariance_blocks(lift, images):
    """A result with covariances, and these as (image, landmark, axis, landmark,
    axis).
    """
    result, _ = lift(images, **WITH_COVARIANCE)
    return result, result.shape_covariance.reshape(8, 10, 3, 10, 3)


def test_error_bars_are_those_of_the_covariance(covariance_blocks):
    result, blocks = covariance_blocks
    variance = np.einsum("npapa->npa", blocks)
    assert result.shape_sd**2 == pytest.approx(variance)


def test_correlations_are_those_of_the_covariance(covariance_blocks):
    result, blocks = covariance_blocks
    sd = result.shape_sd
    for row, (a, b) in enumerate([(0, 1), (0, 2), (1, 2)]):
        covariance = np.einsum("npp->np", blocks[:, :, a, :, b])
        expected = covariance / (sd[..., a] * sd[..., b])
        assert result.shape_correlation[..., row] == pytest.approx(expected, abs=1e-6)


def test_error_bars_are_in_the_unit_of_the_landmarks(lift, images):
    larger = images.replaced(landmarks=10 * images.landmarks)
    result, _ = lift(images)
    grown, _ = lift(larger)
    assert grown.shape_sd == pytest.approx(10 * result.shape_sd, rel=1e-4)


def test_p_values_are_probabilities(lift, images):
    result, _ = lift(images)
    assert (result.p_value >= 0).all()
    assert (result.p_value <= 1).all()
    assert set(result.status) == {"converged"}


def test_noise_widens_error_bars(lift, images):
    plain, _ = lift(images)
    noisy, _ = lift(images, noise=2.0)
    assert np.median(noisy.shape_sd[:, :2]) > np.median(plain.shape_sd[:, :2])


def test_implausible_images_are_reported_and_keep_their_status(
    lift, images, monkeypatch
):
    nothing_is_plausible = trust.LIMITS._replace(min_p_value=0.999999)
    monkeypatch.setattr(trust, "LIMITS", nothing_is_plausible)
    result, outcomes = lift(images)
    (reasons,) = [reasons for outcome in outcomes for reasons in outcome.reasons]
    assert reasons.text == "implausible landmarks"
    assert set(reasons.items) == set(result.items)
    assert not result.trusted.any()
    assert set(result.reasons) == {"implausible landmarks"}
    assert set(result.status) == {"converged"}


# Cameras

WITH_PROOF = {"save": {"covariance": True, "proof": True}}

LONG_LENS = {"focal": 1e7, "principal_point": [100.0, 50.0]}

NEAR = {"focal": 60.0, "principal_point": [80.0, 50.0]}


def test_images_far_from_a_long_lens_are_those_of_weak_perspective(lift, images):
    weak, _ = lift(images)
    result, _ = lift(images, camera=LONG_LENS)
    distance = result.camera_translation[:, 2]
    assert result.shapes == pytest.approx(weak.shapes, abs=1e-3)
    assert result.shape_sd == pytest.approx(weak.shape_sd, rel=1e-3, abs=1e-4)
    assert result.landmarks_fitted == pytest.approx(weak.shapes[..., :2], abs=1e-3)
    assert distance == pytest.approx(1e7 / result.scale, rel=1e-6)


def test_a_proof_comes_along_with_a_camera(lift, images, tmp_path):
    _, outcomes = lift(images, camera=LONG_LENS, **WITH_PROOF)
    assert not failures(outcomes)
    with h5py.File(tmp_path / "result.h5") as file:
        for name in ("dual", "convex_objective"):
            assert np.isfinite(file[name][:].sum())


def test_a_near_camera_sees_other_landmarks_than_weak_perspective(lift, images):
    result, _ = lift(images, camera=NEAR, **WITH_PROOF)
    difference = np.abs(result.landmarks_fitted - result.shapes[..., :2])
    assert difference.max() > 0.1
    for name in ("shape_covariance", "camera_translation", "focal", "principal_point"):
        assert np.isfinite(result.column(name)).all()
