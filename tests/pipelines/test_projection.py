"""`project`: views of known shapes, with what is carried along and what is drawn at
random.
"""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from shapefit.config import ProjectConfig
from shapefit.geometry.rotations import random_rotations
from shapefit.io import (
    open_landmarks,
    write_shapes,
)
from shapefit.pipelines.projection import (
    HIDDEN_STREAM,
    IMAGES_DRAWN_AT_ONCE,
    NOISE_STREAM,
    VIEW_STREAM,
    add_noise,
    hide_share,
    random_stream,
)
from shapefit.pipelines.projection import (
    project_shapes as run,
)
from shapefit.records import Shapes
from tests.io.files import load

NAMES = ("head", "left", "right", "foot", "hand")
LENGTHS = {"walk": 5, "run": 3}


@pytest.fixture
def shapes(rng):
    """Sequences of 5 and 3 frames, the second begun before the first one ends."""
    sequences = ("walk", "walk", "run", "walk", "run", "walk", "walk", "run")
    subjects = [f"subject of {name}" for name in sequences]
    of_another_view = np.tile(2 * np.eye(3), (8, 1, 1))
    extras = {
        "subject": np.array(subjects, object),
        "true_rotation": of_another_view,
        "corrupted": np.arange(8),
    }
    return Shapes(
        rng.standard_normal((8, 5, 3)),
        landmark_names=NAMES,
        items=tuple(f"item{i}" for i in range(8)),
        sequences=sequences,
        unit="m",
        extras=extras,
        mirror_index=np.array([0, 2, 1, 3, 4]),
    )


@pytest.fixture
def many(rng):
    """More shapes than fit into two blocks."""
    count = 2 * IMAGES_DRAWN_AT_ONCE + 100
    return Shapes(
        rng.standard_normal((count, 5, 3)),
        landmark_names=NAMES,
        items=tuple(map(str, range(count))),
    )


def view(folder, shapes, **keys):
    """Project shapes; return images and outcomes."""
    source = folder / "shapes.h5"
    output = folder / "views.h5"
    write_shapes(source, shapes)
    outcomes = list(run(ProjectConfig(shapes=[source], output=output, **keys)))
    return load(output), outcomes


def rotations_of(images):
    """Return the rotations (n, 3, 3) by which images were made."""
    return images.column("true_rotation")


def test_every_image_is_the_shape_seen_under_its_true_rotation(tmp_path, shapes):
    images, _ = view(tmp_path, shapes, camera={"view": "random"})
    R = rotations_of(images)
    turned = R @ shapes.as_columns()
    different = np.unique(R.round(6), axis=0)
    assert_allclose(images.as_columns(), turned[:, :2], atol=1e-12)
    assert len(different) == 8


def test_a_fixed_camera_uses_the_given_rotation(tmp_path, shapes):
    rotation = ((0.0, 0.0, -1.0), (0.0, 1.0, 0.0), (1.0, 0.0, 0.0))
    images, _ = view(tmp_path, shapes, camera={"view": rotation})
    x, y = np.moveaxis(images.landmarks, 2, 0)
    assert_array_equal(x, -shapes.shapes[..., 2])
    assert_array_equal(y, shapes.shapes[..., 1])
    assert_array_equal(rotations_of(images), [rotation] * 8)


def turns_about_y(R):
    """Return by which share of a turn about y these are (n,), from 0 to 1."""
    return np.arctan2(R[:, 0, 2], R[:, 0, 0]) / (2 * np.pi) % 1


@pytest.mark.parametrize(("y_axis", "up"), [("down", -1), ("up", 1)])
@pytest.mark.parametrize("name", LENGTHS)
def test_each_sequence_turns_once_whatever_stands_between_its_frames(
    tmp_path, shapes, y_axis, up, name
):
    images, _ = view(tmp_path, shapes, y_axis=y_axis)
    frames = [i for i, sequence in enumerate(shapes.sequences) if sequence == name]
    count = LENGTHS[name]
    R = rotations_of(images)[frames]
    expected_turns = np.arange(count) / count
    assert images.y_axis == y_axis
    assert_allclose(turns_about_y(R), expected_turns, atol=1e-12)
    assert_allclose(R[:, 1], [[0, up, 0]] * count, atol=1e-12)
    assert_allclose(np.linalg.det(R), 1, atol=1e-12)


def test_a_sequence_of_many_batches_turns_once(tmp_path, many):
    images, _ = view(tmp_path, many)
    expected_turns = np.arange(len(many)) / len(many)
    turns = turns_about_y(rotations_of(images))
    assert_allclose(turns, expected_turns, atol=1e-12)


def test_names_sequences_unit_and_further_datasets_are_carried(tmp_path, shapes):
    images, _ = view(tmp_path, shapes)
    assert images.landmark_names == NAMES
    assert images.items == shapes.items
    assert images.sequences == shapes.sequences
    assert images.unit == "m"
    assert images.y_axis == "down"
    assert images.confidence is None
    assert list(images.column("subject")) == list(shapes.column("subject"))
    assert list(images.column("mirror_index")) == [0, 2, 1, 3, 4]
    assert images.column("corrupted") is None


def test_a_weak_perspective_camera_scales_landmarks_and_noise_has_their_unit(
    tmp_path, many
):
    plain, _ = view(tmp_path, many, noise=0.1)
    scaled, _ = view(tmp_path, many, noise=20.0, camera={"scale": 200.0})
    expected = 200 * plain.landmarks
    assert_allclose(scaled.landmarks, expected, rtol=1e-9, atol=1e-9)
    assert plain.unit == "unknown"
    assert scaled.unit == "px"


RANDOM_VIEWS = {"noise": 0.1, "hidden": 0.3, "camera": {"view": "random"}}


def test_a_seed_means_the_same_in_every_version():
    assert (VIEW_STREAM, NOISE_STREAM, HIDDEN_STREAM) == (0, 1, 2)


def test_the_seed_decides(tmp_path, shapes):
    of_views = random_stream(3, VIEW_STREAM, 0)
    of_noise = random_stream(3, NOISE_STREAM, 0)
    of_hidden = random_stream(3, HIDDEN_STREAM, 0)
    R = random_rotations(IMAGES_DRAWN_AT_ONCE, of_views)[:8]
    turned = (R @ shapes.as_columns())[:, :2]
    expected = hide_share(add_noise(turned, 0.1, of_noise), 0.3, of_hidden)
    images, _ = view(tmp_path, shapes, seed=3, **RANDOM_VIEWS)
    assert_allclose(images.as_columns(), expected, rtol=1e-12)


def test_another_seed_draws_other_images(tmp_path, shapes):
    first, _ = view(tmp_path, shapes, seed=3, **RANDOM_VIEWS)
    other, _ = view(tmp_path, shapes, seed=2, **RANDOM_VIEWS)
    assert not np.array_equal(first.landmarks, other.landmarks, equal_nan=True)


def test_images_are_drawn_in_batches(tmp_path, many):
    _, outcomes = view(tmp_path, many, **RANDOM_VIEWS)
    done = [outcome.done for outcome in outcomes]
    assert done == [IMAGES_DRAWN_AT_ONCE, IMAGES_DRAWN_AT_ONCE, 100, 0]
    assert {outcome.total for outcome in outcomes} == {len(many)}


def test_an_image_depends_on_its_place_alone(tmp_path, many):
    count = IMAGES_DRAWN_AT_ONCE + 50
    whole, _ = view(tmp_path, many, **RANDOM_VIEWS)
    part, _ = view(tmp_path, many.take(slice(count)), **RANDOM_VIEWS)
    assert_array_equal(part.landmarks, whole.landmarks[:count])


def test_no_shapes_give_a_file_without_images(tmp_path, shapes):
    images, outcomes = view(tmp_path, shapes.take(slice(0)))
    assert len(images) == 0
    assert [outcome.done for outcome in outcomes] == [0, 0]


P = 15


@pytest.fixture
def landmarks(rng):
    return rng.standard_normal((IMAGES_DRAWN_AT_ONCE, 2, P))


def test_noise_is_gaussian_of_the_given_deviation(landmarks, rng):
    """Its moments are those of a Gaussian, up to five standard errors."""
    noise = (add_noise(landmarks, 0.02, rng) - landmarks) / 0.02
    count = noise.size
    mean = noise.mean()
    fourth_moment = (noise**4).mean()
    product_of_axes = (noise[:, 0] * noise[:, 1]).mean()
    assert abs(mean) < 5 / np.sqrt(count)
    assert noise.std() == pytest.approx(1, abs=5 / np.sqrt(2 * count))
    assert fourth_moment == pytest.approx(3, abs=5 * np.sqrt(96 / count))
    assert abs(product_of_axes) < 5 / np.sqrt(count / 2)


SHARES = [0.02, 0.2, 0.5]


@pytest.mark.parametrize("share", SHARES)
def test_each_image_has_its_share_of_hidden_landmarks(landmarks, rng, share):
    hidden_x, hidden_y = np.moveaxis(np.isnan(hide_share(landmarks, share, rng)), 1, 0)
    counts = hidden_x.sum(axis=1)
    expected = share * P
    standard_error = 0.5 / np.sqrt(IMAGES_DRAWN_AT_ONCE)
    assert_array_equal(hidden_x, hidden_y)
    assert set(counts) <= {int(np.floor(expected)), int(np.ceil(expected))}
    assert counts.mean() == pytest.approx(expected, abs=5 * standard_error)


@pytest.mark.parametrize("share", SHARES)
def test_each_landmark_is_hidden_as_often(landmarks, rng, share):
    hidden = np.isnan(hide_share(landmarks, share, rng))[:, 0]
    standard_error = np.sqrt(share * (1 - share) / IMAGES_DRAWN_AT_ONCE)
    assert_allclose(hidden.mean(axis=0), share, atol=5 * standard_error)


@pytest.mark.parametrize("origin", [0, 3])
def test_shapes_about_a_landmark_give_images_without_a_warning(
    shapes, tmp_path, origin
):
    """Of which one landmark is at exactly (0, 0) in every image, and was found."""
    about_origin = shapes.shapes - shapes.shapes[:, [origin]]
    view(tmp_path, shapes.replaced(shapes=about_origin))
    with open_landmarks([tmp_path / "views.h5"]) as source:
        images = source.whole()
        assert source.notes == ()
    assert (images.landmarks[:, origin] == 0).all()
