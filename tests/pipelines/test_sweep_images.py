"""Which images a sweep fits: those that show enough, every n-th of them, some landmarks wrong."""

import numpy as np
import pytest

from shapefit.config.commands.sweep import CorruptionConfig
from shapefit.errors import InputError
from shapefit.io import LandmarkSet
from shapefit.pipelines.sweeps import Choice, choose_images
from tests.io.files import load, save

NAMES = tuple("abcdef")


@pytest.fixture
def images(rng):
    """Twenty images; image i shows i mod 7 landmarks, six at most."""
    landmarks = rng.standard_normal((20, 2, 6))
    for i in range(20):
        landmarks[i, :, i % 7 :] = np.nan
    return LandmarkSet(
        landmarks=landmarks, landmark_names=NAMES, items=tuple(f"image{i}" for i in range(20))
    )


@pytest.fixture
def choose(tmp_path, images):
    def choose(least_visible=0, offset=0, every=1, corruption=None, names=NAMES, images=images):
        save(tmp_path / "all.h5", images)
        chosen, warm_up = tmp_path / "chosen.h5", tmp_path / "warm_up.h5"
        choice = Choice(least_visible, offset, every)
        choose_images([tmp_path / "all.h5"], choice, corruption, names, chosen, warm_up)
        return load(chosen), load(warm_up)

    return choose


@pytest.mark.parametrize("block", [3, 1024])
@pytest.mark.parametrize(("offset", "every"), [(0, 1), (0, 2), (1, 2), (3, 4)])
def test_every_nth_of_the_images_that_show_enough(
    choose, images, offset, every, block, monkeypatch
):
    monkeypatch.setattr("shapefit.pipelines.sweeps.BATCH", block)
    chosen, warm_up = choose(least_visible=4, offset=offset, every=every)
    enough = [f"image{i}" for i in range(20) if i % 7 >= 4]
    assert chosen.items == tuple(enough[offset::every])
    assert warm_up.items == chosen.items[:8]
    rows = [images.items.index(item) for item in chosen.items]
    np.testing.assert_array_equal(chosen.landmarks, images.landmarks[rows])
    assert "corrupted" not in chosen.columns


def test_what_is_drawn_for_an_image_does_not_depend_on_the_choice(choose, images):
    corruption = CorruptionConfig(share=0.5, seed=2)
    everything, _ = choose(corruption=corruption)
    some, _ = choose(least_visible=4, offset=1, every=2, corruption=corruption)
    rows = [everything.items.index(item) for item in some.items]
    np.testing.assert_array_equal(some.landmarks, everything.landmarks[rows])
    wrong = everything.columns["corrupted"].astype(bool)
    np.testing.assert_array_equal(some.columns["corrupted"].astype(bool), wrong[rows])
    changed = (everything.landmarks != images.landmarks) & np.isfinite(images.landmarks)
    boxed = [i for i in range(20) if i % 7 != 1]  # one landmark alone has no box to be drawn from
    np.testing.assert_array_equal(changed.any(axis=1)[boxed], wrong[boxed])
    assert wrong.any()
    other, _ = choose(corruption=CorruptionConfig(share=0.5, seed=3))
    assert (other.columns["corrupted"] != everything.columns["corrupted"]).any()


def test_landmarks_without_confidence_are_hidden(choose, images):
    seen = np.isfinite(images.landmarks[:, 0])
    placed = np.where(seen[:, None], images.landmarks, 100.0)
    doubtful = images.replaced(landmarks=placed, confidence=0.5 * seen)
    keys = {"least_visible": 4, "corruption": CorruptionConfig(share=0.5)}
    expected, _ = choose(**keys)
    found, _ = choose(images=doubtful, **keys)
    assert found.items == expected.items
    np.testing.assert_array_equal(found.columns["corrupted"], expected.columns["corrupted"])
    shown = np.isfinite(expected.landmarks)
    np.testing.assert_array_equal(found.landmarks, np.where(shown, expected.landmarks, 100.0))


def test_landmarks_that_were_wrong_before_stay_so(choose, images):
    before = np.zeros(images.landmarks[:, 0].shape, bool)
    before[:, 0] = True
    keys = {"corruption": CorruptionConfig(share=0.5)}
    new = choose(**keys)[0].columns["corrupted"].astype(bool)
    extras = {**images.further, "corrupted": before}
    found, _ = choose(images=images.replaced(further=extras), **keys)
    assert not new[:, 0].all()
    np.testing.assert_array_equal(found.columns["corrupted"].astype(bool), new | before)


def test_the_labels_are_in_the_order_of_the_dictionary(choose):
    corruption = CorruptionConfig(share=0.5)
    chosen, _ = choose(corruption=corruption, names=("z", *NAMES[::-1]))
    assert chosen.landmark_names == ("z", *NAMES[::-1])
    assert chosen.columns["corrupted"].shape == (20, 7)
    hidden = np.isnan(chosen.landmarks[:, 0])
    assert hidden[:, 0].all()
    assert not chosen.columns["corrupted"].astype(bool)[hidden].any()


def test_no_image_left_is_an_error_that_says_so(choose):
    with pytest.raises(InputError, match=r"2 images with 6 visible landmarks or more; lower"):
        choose(least_visible=6, offset=2)


def test_every_block_of_images_has_draws_of_its_own(choose, images, rng, monkeypatch):
    monkeypatch.setattr("shapefit.pipelines.sweeps.BATCH", 10)
    alike = images.replaced(landmarks=np.tile(rng.standard_normal((10, 2, 6)), (2, 1, 1)))
    found, _ = choose(images=alike, corruption=CorruptionConfig(share=0.5))
    first, second = found.take(slice(10)), found.take(slice(10, 20))
    assert (first.columns["corrupted"] != second.columns["corrupted"]).any()
    again, _ = choose(images=alike.take(slice(10)), corruption=CorruptionConfig(share=0.5))
    np.testing.assert_array_equal(again.landmarks, first.landmarks)
