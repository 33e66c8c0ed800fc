"""Planted files: how wide the prior is and how exact landmarks are is found of the images."""

import json

import numpy as np
import pytest

from shapefit.config import FitConfig
from shapefit.dictionary.mixture import Mixture
from shapefit.dictionary.model import Dictionary
from shapefit.geometry.rotations import random_rotations
from shapefit.io import LandmarkSet, write_dictionary
from shapefit.pipelines.fit.prepare import FIRST, prepare
from shapefit.pipelines.fit.width import find_width, likeliest
from tests.pipelines.fitted import fit_images
from tests.pipelines.told import texts

P, IMAGES = 12, 60
NAMES = tuple(f"point{j}" for j in range(P))
RESIDUAL_VARIANCE = 0.002


@pytest.fixture(scope="module")
def planted(tmp_path_factory):
    """A dictionary with one Gaussian, and what draws images whose truth is as wide as stated."""
    rng = np.random.default_rng(5)
    mean = rng.normal(size=(3, P))
    root = 0.12 * rng.normal(size=(3 * P, 8)) / np.sqrt(8)
    C = root @ root.T * 8 / 3 + 1e-3 * np.eye(3 * P)
    prior = Mixture(np.ones(1), mean[None], C[None])
    path = tmp_path_factory.mktemp("width") / "dictionary.h5"
    made = Dictionary(
        mean[None] / 4, NAMES, mean, prior=prior, residual_variance=np.array([RESIDUAL_VARIANCE])
    )
    write_dictionary(path, made)

    def draw(width, residual_variance, wrong=None):
        x = np.linalg.cholesky(width * C) @ rng.normal(size=(3 * P, IMAGES))
        shapes = random_rotations(IMAGES, rng) @ (mean + x.T.reshape(IMAGES, 3, P))
        w = shapes[:, :2] + np.sqrt(residual_variance) * rng.normal(size=(IMAGES, 2, P))
        if wrong is not None:
            w[:, :, wrong] += 3 * rng.normal(size=(IMAGES, 2))
        items = tuple(f"image{i}" for i in range(IMAGES))
        images = LandmarkSet(landmarks=100 * w, landmark_names=NAMES, items=items)
        return images, 100 * shapes

    return path, made, draw


def estimate(planted, images, **prior):
    path, made, _ = planted
    keys = {"method": "posterior", "camera": {"focal": "none"}, "prior": prior}
    config = FitConfig(landmarks=[str(path)], dictionary=str(path), output="result.h5", **keys)
    found = prepare(config, made, lambda: images.take(slice(0, FIRST)))
    return found, found.values["prior"]


@pytest.mark.parametrize("width", [1, 4])
@pytest.mark.parametrize("residual_variance", [RESIDUAL_VARIANCE, 8 * RESIDUAL_VARIANCE])
def test_the_factors_that_images_have_are_found(planted, width, residual_variance):
    found, keys = estimate(planted, planted[2](width, residual_variance)[0])
    assert (keys["scale"], keys["residual_variance"]) == (
        width,
        pytest.approx(residual_variance),
    )
    said = any("nats an image" in line for line in found.lines)
    assert said == ((width, residual_variance) != (1, RESIDUAL_VARIANCE))


def test_landmarks_more_exact_than_the_misfit_of_the_dictionary_keep_it(planted):
    _, keys = estimate(planted, planted[2](1, RESIDUAL_VARIANCE / 20)[0])
    assert keys["residual_variance"] == RESIDUAL_VARIANCE


def test_what_is_stated_is_obeyed(planted):
    images, _ = planted[2](4, 8 * RESIDUAL_VARIANCE)
    _, keys = estimate(planted, images, scale=1.5)
    assert keys["scale"] == 1.5
    assert keys["residual_variance"] > RESIDUAL_VARIANCE
    found, keys = estimate(planted, images, scale=1.5, residual_variance=0.1)
    assert keys["residual_variance"] == 0.1
    assert not found.lines


def test_few_images_say_nothing(planted):
    _, keys = estimate(planted, planted[2](4, RESIDUAL_VARIANCE)[0].take(slice(0, 9)))
    assert (keys["scale"], keys["residual_variance"]) == (1, RESIDUAL_VARIANCE)


def test_regions_hold_where_the_truth_is_wider_than_the_prior(planted, tmp_path):
    images, shapes = planted[2](8, RESIDUAL_VARIANCE)
    camera = {"focal": "none"}

    def held(**prior):
        keys = {"method": "posterior", "camera": camera, "prior": prior}
        result, _ = fit_images(tmp_path, images, planted[0], **keys)
        away = (result.shapes - shapes)[:, 2] / result.shape_sd[:, 2]
        return (np.abs(away - away.mean(axis=1, keepdims=True)) < 1.645).mean(), result

    own, result = held()
    assert own == pytest.approx(0.9, abs=0.08)
    assert held(scale=1)[0] < 0.75
    assert json.loads(result.attributes["config"])["prior"]["scale"] == 8
    assert "prior 8 times as wide" in result.attributes["estimated"]


def test_of_pairs_as_likely_the_widest_is_taken_with_the_least_misfit():
    noise = np.random.default_rng(0).normal(size=(4, 100))
    noise -= noise.mean(axis=1, keepdims=True)
    of = {
        (1.0, 1.0): -10 + noise[0],
        (2.0, 1.0): -5.05 + noise[1],
        (2.0, 2.0): -5 + noise[2],
        (4.0, 1.0): -7 + noise[3],
    }
    found = likeliest(of)
    assert (found.prior, found.residual_variance) == (2, 1)
    assert found.gain == pytest.approx(4.95)


@pytest.mark.parametrize("best", [(1.0, 1.0), (2.0, 1.0), (1.0, 2.0), (8.0, 2.0)])
def test_a_wider_prior_or_a_larger_misfit_alone_makes_all_pairs_be_tried(best):
    images = LandmarkSet(np.zeros((30, 2, P)), NAMES, tuple(map(str, range(30))))

    def evidence(pair, some):
        return np.full(len(some), -np.abs(np.log2(pair) - np.log2(best)).sum())

    found = find_width(evidence, images)
    assert (found.prior, found.residual_variance) == best
    assert found.gain == pytest.approx(np.log2(best).sum())


def test_a_landmark_that_is_mostly_wrong_is_named_and_frames_stay_trusted(planted, tmp_path):
    images, _ = planted[2](1, RESIDUAL_VARIANCE, wrong=3)
    keys = {"method": "posterior", "camera": {"focal": "none"}}
    result, outcomes = fit_images(tmp_path, images, planted[0], **keys)
    (told,) = [each for each in texts(outcomes) if "grossly wrong" in each]
    assert int(told.split()[0]) > 45
    assert "in which point3 is grossly wrong" in told
    assert result.columns["trusted"].mean() > 0.8
    _, outcomes = fit_images(tmp_path, images, planted[0], **keys, rename={"point3": "unused"})
    assert not any("grossly wrong" in each for each in texts(outcomes))


def test_images_of_another_class_are_said_to_be(planted, tmp_path):
    """Shapes that the widest prior does not hold, and left and right that nobody exchanged."""
    images, _ = planted[2](1, RESIDUAL_VARIANCE)
    other = images.replaced(landmarks=images.landmarks[..., [*range(6, P), *range(6)]])
    keys = {"method": "posterior", "camera": {"focal": "none"}}
    result, outcomes = fit_images(tmp_path, other, planted[0], **keys)
    if (result.columns["p_value"] < 0.05).mean() > 0.5:
        assert any("another class" in each for each in texts(outcomes))
    keys["prior"] = {"scale": 1, "residual_variance": RESIDUAL_VARIANCE}
    _, outcomes = fit_images(tmp_path, other, planted[0], **keys)
    assert [each for each in texts(outcomes) if "another class" in each]
    _, outcomes = fit_images(tmp_path, images, planted[0], **keys)
    assert not any("implausible" in each for each in texts(outcomes))


def test_a_landmark_that_is_mostly_wrong_does_not_make_the_others_less_exact(planted):
    images, _ = planted[2](1, RESIDUAL_VARIANCE, wrong=3)
    _, keys = estimate(planted, images)
    assert (keys["scale"], keys["residual_variance"]) == (1, RESIDUAL_VARIANCE)
