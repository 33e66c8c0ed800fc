"""AlphaPose's one file of all images, in its two layouts."""

from __future__ import annotations

import numpy as np
import pytest

from shapefit.errors import InputError

from .conftest import read

VERSION = "AlphaPose v0.3"


@pytest.mark.parametrize(
    ("people", "keypoints"), [("people", "pose_keypoints_2d"), ("bodies", "joints")]
)
def test_both_layouts(written, rng, people, keypoints):
    numbers = rng.uniform(0.1, 1, (3, 18, 3))
    numbers[2, 4] = 0
    images = {
        "7.jpg": {
            "version": VERSION,
            people: [{keypoints: numbers[k].ravel().tolist()} for k in (0, 1)],
        },
        "9.jpg": {"version": VERSION, people: []},
        "10.jpg": {"version": VERSION, people: [{keypoints: numbers[2].ravel().tolist()}]},
    }
    found, notes = read(written("walk.json", images))
    assert list(found.items) == ["walk/7/0", "walk/7/1", "walk/10/0"]
    assert notes == ()
    numbers[2, 4] = np.nan
    np.testing.assert_array_equal(found.landmarks, numbers[..., :2].transpose(0, 2, 1))
    np.testing.assert_array_equal(found.weights(), np.nan_to_num(numbers[..., 2]))


def test_confidences_of_models_of_coco(written):
    person = {"pose_keypoints_2d": [1.0, 2.0, 4.5] * 18}
    found, notes = read(written("walk.json", {"0.jpg": {"version": VERSION, "people": [person]}}))
    np.testing.assert_allclose(found.weights(), 0.75)
    assert "confidences divided by 6" in notes[0]


@pytest.mark.parametrize(
    ("second", "message"),
    [
        ({"faces": []}, "1.jpg: no list of people"),
        (3, "1.jpg: no list of people"),
        ({"people": [3]}, "1.jpg: a person that is no object"),
        ({"people": [{"pose_keypoints_2d": [1, 2]}]}, "a person of 2 numbers"),
    ],
)
def test_damaged(written, second, message):
    with pytest.raises(InputError, match=message):
        read(written("walk.json", {"0.jpg": {"people": []}, "1.jpg": second}))
