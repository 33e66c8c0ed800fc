"""`project`: views of known shapes, with what is carried along and what is drawn at
random.
"""

import numpy as np
import pytest

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
    return Shapes(
        rng.standard_normal((8, 3, 5)).swapaxes(1, 2),
        landmark_names=NAMES,
        items=tuple(f"item{i}" for i in range(8)),
        sequences=sequences,
        unit="m",
        extras={
            "subject": np.array([f"subject of {name}" for name in sequences], object),
            "true_rotation": np.tile(2 * np.eye(3), (8, 1, 1)),  # of another view
            "corrupted": np.arange(8),
        },
        mirror_index=np.array([0, 2, 1, 3, 4]),
    )


@pytest.fixture
def many(rng):
    """More shapes than fit into two blocks."""
    n = 2 * IMAGES_DRAWN_AT_ONCE + 100
    return Shapes(
        rng.standard_normal((n, 3, 5)).swapaxes(1, 2),
        landmark_names=NAMES,
        items=tuple(map(str, range(n))),
    )


def view(folder, *parts, **keys):
    """Project sets of shapes, each in a file of its own; returns images and
    outcomes.
    """
    paths = [folder / f"shapes{number}.h5" for number, _ in enumerate(parts)]
    for path, shapes in zip(paths, parts, strict=True):
        write_shapes(path, shapes)
    config = ProjectConfig(shapes=paths, output=folder / "views.h5", **keys)
    outcomes = list(run(config))
    images = load(config.output)
    return images, outcomes


def test_every_image_is_the_shape_seen_under_its_true_rotation(tmp_path, shapes):
    images, _ = view(tmp_path, shapes, camera={"view": "random"})
    R = images.column("true_rotation")
    np.testing.assert_allclose(
        images.as_columns(), (R @ shapes.as_columns())[:, :2], atol=1e-12
    )
    assert len(np.unique(R.round(6), axis=0)) == 8


def test_a_fixed_camera_uses_the_given_rotation(tmp_path, shapes):
    rotation = ((0.0, 0.0, -1.0), (0.0, 1.0, 0.0), (1.0, 0.0, 0.0))
    images, _ = view(tmp_path, shapes, camera={"view": rotation})
    np.testing.assert_array_equal(images.as_columns()[:, 0], -shapes.as_columns()[:, 2])
    np.testing.assert_array_equal(images.as_columns()[:, 1], shapes.as_columns()[:, 1])
    np.testing.assert_array_equal(
        images.column("true_rotation"), np.tile(rotation, (8, 1, 1))
    )


@pytest.mark.parametrize(("y_axis", "up"), [("down", -1), ("up", 1)])
def test_each_sequence_turns_once_whatever_stands_between_its_frames(
    tmp_path, shapes, y_axis, up
):
    images, _ = view(tmp_path, shapes, y_axis=y_axis)
    assert images.y_axis == y_axis
    for name, length in LENGTHS.items():
        frames = [i for i, sequence in enumerate(shapes.sequences) if sequence == name]
        R = images.column("true_rotation")[frames]
        turned = np.arctan2(R[:, 0, 2], R[:, 0, 0]) / (2 * np.pi) % 1
        np.testing.assert_allclose(turned, np.arange(length) / length, atol=1e-12)
        np.testing.assert_allclose(
            R[:, 1], np.tile([0, up, 0], (length, 1)), atol=1e-12
        )
        np.testing.assert_allclose(np.linalg.det(R), 1, atol=1e-12)


def test_a_sequence_of_many_batches_turns_once(tmp_path, many):
    R = view(tmp_path, many)[0].column("true_rotation")
    turned = np.arctan2(R[:, 0, 2], R[:, 0, 0]) / (2 * np.pi) % 1
    np.testing.assert_allclose(turned, np.arange(len(many)) / len(many), atol=1e-12)


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
    np.testing.assert_allclose(
        scaled.landmarks, 200 * plain.landmarks, rtol=1e-9, atol=1e-9
    )
    assert plain.unit == "unknown"
    assert scaled.unit == "px"


def test_the_seed_decides(tmp_path, shapes):
    streams = (VIEW_STREAM, NOISE_STREAM, HIDDEN_STREAM)
    assert streams == (0, 1, 2)  # a seed means the same in every version
    R = random_rotations(IMAGES_DRAWN_AT_ONCE, random_stream(3, VIEW_STREAM, 0))[:8]
    noisy = add_noise(
        (R @ shapes.as_columns())[:, :2], 0.1, random_stream(3, NOISE_STREAM, 0)
    )
    keys = {"noise": 0.1, "hidden": 0.3, "camera": {"view": "random"}}
    first, _ = view(tmp_path, shapes, seed=3, **keys)
    other, _ = view(tmp_path, shapes, seed=2, **keys)
    np.testing.assert_allclose(
        first.as_columns(),
        hide_share(noisy, 0.3, random_stream(3, HIDDEN_STREAM, 0)),
        rtol=1e-12,
    )
    assert not np.array_equal(first.as_columns(), other.as_columns(), equal_nan=True)


def test_an_image_depends_on_its_place_alone(tmp_path, many):
    keys = {"noise": 0.1, "hidden": 0.2, "camera": {"view": "random"}}
    whole, told = view(tmp_path, many, **keys)
    batches = [(outcome.done, outcome.total) for outcome in told]
    assert batches == [
        (n, len(many)) for n in (IMAGES_DRAWN_AT_ONCE, IMAGES_DRAWN_AT_ONCE, 100, 0)
    ]
    part, _ = view(tmp_path, many.take(slice(IMAGES_DRAWN_AT_ONCE + 50)), **keys)
    assert np.array_equal(
        whole.as_columns()[: IMAGES_DRAWN_AT_ONCE + 50],
        part.as_columns(),
        equal_nan=True,
    )


def test_no_shapes_give_a_file_without_images(tmp_path, shapes):
    images, outcomes = view(tmp_path, shapes.take(slice(0)))
    assert len(images) == 0
    assert [outcome.done for outcome in outcomes] == [0, 0]


P = 15


@pytest.fixture
def noisy(rng):
    return rng.standard_normal((IMAGES_DRAWN_AT_ONCE, 2, P))


def test_noise_is_gaussian_of_the_given_deviation(noisy, rng):
    noise = (add_noise(noisy, 0.02, rng) - noisy) / 0.02
    count = noise.size
    assert abs(noise.mean()) < 5 / np.sqrt(count)
    assert noise.std() == pytest.approx(1, abs=5 / np.sqrt(2 * count))
    assert (noise**4).mean() == pytest.approx(3, abs=5 * np.sqrt(96 / count))
    assert abs((noise[:, 0] * noise[:, 1]).mean()) < 5 / np.sqrt(count / 2)


@pytest.mark.parametrize("share", [0.02, 0.2, 0.5])
def test_each_image_has_its_share_of_hidden_landmarks(noisy, rng, share):
    hidden = np.isnan(hide_share(noisy, share, rng))
    assert np.array_equal(hidden[:, 0], hidden[:, 1])
    number = hidden[:, 0].sum(axis=1)
    assert set(number) <= {int(np.floor(share * P)), int(np.ceil(share * P))}
    assert number.mean() == pytest.approx(
        share * P, abs=5 * 0.5 / np.sqrt(IMAGES_DRAWN_AT_ONCE)
    )
    often = hidden[:, 0].mean(axis=0)
    np.testing.assert_allclose(
        often, share, atol=5 * np.sqrt(share * (1 - share) / IMAGES_DRAWN_AT_ONCE)
    )


@pytest.mark.parametrize("origin", [0, 3])
def test_shapes_about_a_landmark_give_images_without_a_warning(
    shapes, tmp_path, origin
):
    """Of which one landmark is at exactly (0, 0) in every image, and was found."""
    about = shapes.as_columns() - shapes.as_columns()[:, :, [origin]]
    view(tmp_path, shapes.replaced(shapes=about.swapaxes(1, 2)))
    (path,) = [path for path in tmp_path.iterdir() if "shapes" not in path.name]
    with open_landmarks([path]) as source:
        assert (source.whole().as_columns()[:, :, origin] == 0).all()
        assert source.notes == ()
