"""Noise, hidden and wrong landmarks have the size and the share that was asked for."""

import numpy as np
import pytest

from shapefit.pipelines.imperfections import (
    BATCH,
    LEAST_VISIBLE,
    Purpose,
    add_noise,
    hide,
    stream,
)

P = 15


@pytest.fixture
def landmarks(rng):
    return rng.standard_normal((BATCH, 2, P))


def test_noise_is_gaussian_of_the_given_deviation(landmarks, rng):
    noise = (add_noise(landmarks, 0.02, rng) - landmarks) / 0.02
    count = noise.size
    assert abs(noise.mean()) < 5 / np.sqrt(count)
    assert noise.std() == pytest.approx(1, abs=5 / np.sqrt(2 * count))
    assert (noise**4).mean() == pytest.approx(3, abs=5 * np.sqrt(96 / count))
    assert abs((noise[:, 0] * noise[:, 1]).mean()) < 5 / np.sqrt(count / 2)


@pytest.mark.parametrize("share", [0.02, 0.2, 0.5])
def test_the_share_of_hidden_landmarks_holds(landmarks, rng, share):
    hidden = np.isnan(hide(landmarks, share, rng))
    assert np.array_equal(hidden[:, 0], hidden[:, 1])
    number = hidden[:, 0].sum(axis=1)
    assert set(number) <= {int(np.floor(share * P)), int(np.ceil(share * P))}
    assert number.mean() == pytest.approx(share * P, abs=5 * 0.5 / np.sqrt(BATCH))
    often = hidden[:, 0].mean(axis=0)
    np.testing.assert_allclose(often, share, atol=5 * np.sqrt(share * (1 - share) / BATCH))


def test_images_have_masks_of_their_own(landmarks, rng):
    hidden = np.isnan(hide(landmarks, 0.4, rng)[:, 0])
    assert len(np.unique(hidden, axis=0)) > 0.8 * BATCH


def test_what_is_not_hidden_stays(landmarks, rng):
    after = hide(landmarks, 0.4, rng)
    assert np.array_equal(after[np.isfinite(after)], landmarks[np.isfinite(after)])


@pytest.mark.parametrize("p", [1, 3, 4, 15])
def test_some_landmarks_stay_visible(rng, p):
    visible = np.isfinite(hide(rng.standard_normal((50, 2, p)), 0.99, rng)[:, 0])
    assert np.array_equal(visible.sum(axis=1), np.full(50, min(p, LEAST_VISIBLE)))


def test_streams_differ_by_seed_purpose_and_block():
    draws = {
        stream(seed, purpose, block).random()
        for seed in (0, 1)
        for purpose in Purpose
        for block in (0, 1)
    }
    assert len(draws) == 2 * len(Purpose) * 2


def test_a_seed_means_the_same_in_every_version():
    """Files of old runs can be made again: neither purposes nor their numbers may change."""
    members = {name: purpose.value for name, purpose in Purpose.__members__.items()}
    assert members == {"VIEW": 0, "NOISE": 1, "HIDDEN": 2}


@pytest.mark.parametrize("spoil", [
    lambda W, rng: add_noise(W, 0.1, rng),
    lambda W, rng: hide(W, 0.3, rng),
])  # fmt: skip
def test_an_image_fares_the_same_however_many_follow(landmarks, spoil):
    whole = spoil(landmarks, np.random.default_rng(3))
    part = spoil(landmarks[:10], np.random.default_rng(3))
    assert np.array_equal(whole[:10], part, equal_nan=True)
