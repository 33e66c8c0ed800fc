"""What is settled of one sample of the images: prior, variance, doubts."""

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from shapefit.config import FitConfig
from shapefit.dictionary.mixture import Mixture
from shapefit.dictionary.model import Dictionary
from shapefit.geometry.rotations import random_rotations
from shapefit.io import (
    write_dictionary,
)
from shapefit.lifting.posterior.p_value import with_p_value_table
from shapefit.pipelines import joints
from shapefit.pipelines.fit import atoms, calibration, choices, posterior, sample
from shapefit.pipelines.fit.calibration import SAMPLE_POOL, calibrate
from shapefit.pipelines.fit.choices import (
    match_to_dictionary,
)
from shapefit.pipelines.fit.image_posterior import ImagePosterior
from shapefit.pipelines.fit.sample import MAX_SAMPLE, Shares, draw_sample
from shapefit.records import Landmarks
from tests.columns import in_rows
from tests.pipelines.fitted import fit_images, texts

P = 12


IMAGE_COUNT = 60


NAMES = tuple(f"point{j}" for j in range(P))


RESIDUAL_VARIANCE = 0.002


@dataclass(frozen=True)
class Planted:
    """A dictionary with one Gaussian, and images whose truth is as wide as stated."""

    path: Path
    dictionary: Dictionary
    rng: np.random.Generator

    def draw(
        self,
        scale: float = 1,
        residual_variance: float = RESIDUAL_VARIANCE,
        wrong: int | None = None,
        error: float = 3.0,
    ) -> Landmarks:
        """Return images of shapes whose covariance is so many times that of the prior;
        one landmark may be wrong in all.
        """
        mean = self.dictionary.prior.means[0]
        C = self.dictionary.prior.covariances[0]
        standard = self.rng.normal(size=(3 * P, IMAGE_COUNT))
        deviations = np.linalg.cholesky(scale * C) @ standard
        shapes = mean + deviations.T.reshape(IMAGE_COUNT, 3, P)
        turned = random_rotations(IMAGE_COUNT, self.rng) @ shapes
        noise = self.rng.normal(size=(IMAGE_COUNT, 2, P))
        w = turned[:, :2] + np.sqrt(residual_variance) * noise
        if wrong is not None:
            w[:, :, wrong] += error * self.rng.normal(size=(IMAGE_COUNT, 2))
        items = tuple(f"image{i}" for i in range(IMAGE_COUNT))
        return Landmarks(in_rows(100 * w), landmark_names=NAMES, items=items)


@pytest.fixture(scope="module")
def planted(tmp_path_factory):
    rng = np.random.default_rng(5)
    mean = rng.normal(size=(3, P))
    root = 0.12 * rng.normal(size=(3 * P, 8)) / np.sqrt(8)
    C = root @ root.T * 8 / 3 + 1e-3 * np.eye(3 * P)
    dictionary = Dictionary(
        mean[None] / 4,
        NAMES,
        mean,
        prior=Mixture(np.ones(1), mean[None], C[None]),
        residual_variance=np.array([RESIDUAL_VARIANCE]),
    )
    with_table = with_p_value_table(dictionary)
    path = tmp_path_factory.mktemp("sample") / "dictionary.h5"
    write_dictionary(path, with_table)
    return Planted(path, with_table, rng)


KEYS = {"method": "posterior", "camera": {"focal": "none"}}


def estimate(planted, images, **prior):
    """Return what a sample of the images settles, and the keys of the prior then."""
    path = str(planted.path)
    config = FitConfig(
        landmarks=[path], dictionary=path, output="result.h5", **KEYS, prior=prior
    )
    match = match_to_dictionary(config, planted.dictionary, images.landmark_names)
    pool = images.take(slice(0, SAMPLE_POOL))
    steps = calibrate(config, match, pool, len(images))
    with pytest.raises(StopIteration) as end:
        next(steps)
    settled = end.value.value
    return settled, settled.config_values(config)["prior"]


def tells_of_the_prior(settled):
    """Say whether a line tells that the prior or the variance was changed."""
    return any("prior widened" in x or "residual var" in x for x in settled.lines)


FACTORS = [
    (1, RESIDUAL_VARIANCE),
    (4, RESIDUAL_VARIANCE),
    (1, 8 * RESIDUAL_VARIANCE),
    (4, 8 * RESIDUAL_VARIANCE),
]


@pytest.mark.parametrize(("scale", "variance"), FACTORS)
def test_the_factors_that_images_have_are_found(planted, scale, variance):
    images = planted.draw(scale, variance)
    settled, prior = estimate(planted, images)
    changed = (scale, variance) != (1, RESIDUAL_VARIANCE)
    assert prior["scale"] == pytest.approx(scale)
    assert prior["residual_variance"] == pytest.approx(variance)
    assert tells_of_the_prior(settled) == changed


def test_landmarks_more_exact_than_those_of_the_dictionary_keep_its_variance(planted):
    images = planted.draw(residual_variance=RESIDUAL_VARIANCE / 20)
    settled, prior = estimate(planted, images)
    assert prior["scale"] == pytest.approx(1)
    assert prior["residual_variance"] == pytest.approx(RESIDUAL_VARIANCE)
    assert not tells_of_the_prior(settled)


def test_factors_that_are_given_are_not_estimated(planted):
    images = planted.draw(4, 8 * RESIDUAL_VARIANCE)
    settled, prior = estimate(planted, images, scale=1.5, residual_variance=0.1)
    assert prior["scale"] == 1.5
    assert prior["residual_variance"] == 0.1
    assert not tells_of_the_prior(settled)


def test_a_landmark_that_is_mostly_wrong_does_not_make_the_others_less_exact(planted):
    images = planted.draw(wrong=3)
    _, prior = estimate(planted, images)
    assert prior["scale"] == 1
    assert prior["residual_variance"] == RESIDUAL_VARIANCE


@pytest.mark.parametrize("shares", [(0.09, 0.26), (0.11, 0.26), (0.09, 0.24)])
def test_less_than_a_tenth_trusted_and_more_than_a_quarter_doubtful_is_told(
    planted, monkeypatch, shares
):
    monkeypatch.setattr(sample, "judge_shares", lambda *given: Shares(*shares))
    images = planted.draw().take(slice(20))
    settled, _ = estimate(
        planted, images, scale=1.0, residual_variance=RESIDUAL_VARIANCE
    )
    expected = shares == (0.09, 0.26)
    assert bool(settled.warnings) == expected
    assert bool(settled.reason) == expected


def test_a_landmark_that_is_mostly_wrong_is_named(planted, tmp_path):
    size_of_the_shape = 1.5
    images = planted.draw(wrong=3, error=size_of_the_shape)
    _, outcomes = fit_images(tmp_path, images, planted.path, **KEYS)
    (told,) = [text for text in texts(outcomes) if "contradicts the model" in text]
    image_count, *_ = told.split()
    assert int(image_count) > 45
    assert "in which point3 contradicts" in told


def some_images(count, **fields):
    """Return images of random points."""
    points = np.random.default_rng(1).random((count, P, 2))
    items = tuple(map(str, range(count)))
    return Landmarks(points, landmark_names=NAMES, items=items, **fields)


def rows_of_sample(planted, images):
    """Return the rows of the images that a sample has."""
    family = ImagePosterior(dictionary=planted.dictionary)
    return np.array(draw_sample(images, family).items, int)


SIZES = [MAX_SAMPLE, 3 * MAX_SAMPLE]


@pytest.mark.parametrize(("rate", "step"), [(None, 12), (50.0, 25), (0.5, 1)])
@pytest.mark.parametrize("count", SIZES)
def test_a_sample_of_sequences_has_pairs_that_are_a_step_apart(
    planted, count, rate, step
):
    images = some_images(count, sequences=("walk",) * count, frame_rate=rate)
    rows = rows_of_sample(planted, images)
    with_a_partner = np.intersect1d(rows + step, rows)
    assert MAX_SAMPLE // 2 <= len(rows) <= MAX_SAMPLE
    assert len(with_a_partner) >= 40


@pytest.mark.parametrize("count", SIZES)
def test_a_sample_of_single_images_is_spread_evenly(planted, count):
    rows = rows_of_sample(planted, some_images(count))
    steps = np.unique(np.diff(rows))
    assert len(rows) == MAX_SAMPLE
    assert len(steps) <= 2


def test_a_sample_has_no_images_of_four_landmarks(planted):
    """Which fit almost any shape."""
    images = some_images(2)
    images.landmarks[0, 5:] = np.nan
    images.landmarks[1, 4:] = np.nan
    assert rows_of_sample(planted, images).tolist() == [0]


ONCE_IN_A_RUN = {
    "calibrate_by_sample": posterior,
    "choose_camera": calibration,
    "draw_sample": sample,
    "find_joints": joints,
    "match_names": choices,
}
"""Function -> the module that calls it."""


def test_names_camera_and_sample_are_found_once(planted, tmp_path, monkeypatch):
    calls = []
    for name, module in ONCE_IN_A_RUN.items():
        real = getattr(module, name)

        def counted(*given, name=name, real=real, **keys):
            calls.append(name)
            return real(*given, **keys)

        monkeypatch.setattr(module, name, counted)
    fit_images(tmp_path, planted.draw(scale=2), planted.path, **KEYS)
    assert sorted(calls) == list(ONCE_IN_A_RUN)


ANNOUNCED = [
    ("convex", 60, "60 images may take up to 4 minutes, 3.8 s each: give"),
    ("convex", 1, "$"),
    ("posterior", 1, "1 image may take up to 110 minutes: give"),
]
"""A method, a number of images, and how the first line begins."""


@pytest.mark.parametrize(("method", "count", "line"), ANNOUNCED)
def test_a_fit_that_takes_long_is_announced_before_it_begins(
    planted, tmp_path, monkeypatch, method, count, line
):
    clock = iter(range(0, 1000, 30))
    seconds_of_one_component = 600 / P**3.5
    monkeypatch.setattr(atoms.time, "perf_counter", lambda: next(clock))
    monkeypatch.setattr(posterior, "SECONDS_PER_IMAGE", seconds_of_one_component)
    images = planted.draw().take(range(count))
    keys = KEYS | {"method": method}
    _, outcomes = fit_images(tmp_path, images, planted.path, **keys)
    assert re.match(line, outcomes[0].line)
