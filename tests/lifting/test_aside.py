"""Feet hang on ankles: what an image shows of them turns them, and moves nothing else."""

from dataclasses import replace

import numpy as np
import pytest

from shapefit.config.named_files import find_dictionary
from shapefit.io import LandmarkSet, read_dictionary
from shapefit.io.skeletons import PEOPLE
from shapefit.pipelines import verify
from tests.pipelines.fitted import fit_images

FEET = slice(15, 21)


@pytest.fixture(scope="module")
def people():
    """The dictionary with feet, without hands and spine."""
    return read_dictionary(find_dictionary("people")).marked(("rtoe", "ltoe"))


@pytest.fixture
def images(people, rng):
    """Bodies of the prior, seen from all sides."""
    n, p = 24, len(people.landmark_names)
    prior = people.prior
    drawn = prior.means[:n] + np.stack(
        [rng.multivariate_normal(np.zeros(3 * p), C).reshape(3, p) for C in prior.covariances[:n]]
    )
    turn = np.linalg.qr(rng.standard_normal((n, 3, 3)))[0]
    turn[:, :, 0] *= np.linalg.det(turn)[:, None]
    return LandmarkSet(
        landmarks=100 * (turn @ drawn)[:, :2],
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
    moved = images.landmarks.copy()
    moved[..., FEET] += 30
    found, other = lift(images), lift(replace(images, landmarks=moved))
    np.testing.assert_array_equal(other.shapes[..., :15], found.shapes[..., :15])
    np.testing.assert_array_equal(other.shape_sd[..., :15], found.shape_sd[..., :15])
    assert (np.abs(found.shapes - other.shapes)[:, :2, FEET].mean(axis=(1, 2)) > 3).all()


def test_feet_that_are_seen_are_nearer_to_the_truth_in_the_image_and_surer(images, lift):
    hidden = images.landmarks.copy()
    hidden[..., FEET] = np.nan
    seen, unseen = lift(images), lift(replace(images, landmarks=hidden))
    off = [
        np.abs(each.landmarks_fitted - images.landmarks)[..., FEET].mean()
        for each in (seen, unseen)
    ]
    assert off[0] < 0.7 * off[1]
    assert seen.shape_sd[:, :2, FEET].mean() < unseen.shape_sd[:, :2, FEET].mean()
    assert (seen.shape_sd > 0).all()


def test_a_file_without_feet_has_a_result_without(images, lift):
    found = lift(images.arrange(PEOPLE, "here", leave_out=True))
    assert found.landmark_names == PEOPLE
    assert "input_shapes" not in found.columns


@pytest.mark.parametrize(
    "camera",
    [
        {"model": "weak-perspective"},
        {"model": "perspective", "focal": 1200.0, "principal_point": [0.0, 0.0]},
    ],
    ids=["weak", "perspective"],
)
def test_a_result_with_feet_is_verified(images, lift, tmp_path, camera):
    lift(images, camera=camera)
    views = (tmp_path / "views.h5",)
    request = verify.Request(tmp_path / "result.h5", find_dictionary("people"), views)
    assert not [outcome.failures for outcome in verify.run(request) if outcome.failures]
