"""Cameras from configs and landmark files, and what no camera is."""

from __future__ import annotations

import numpy as np
import pytest

from shapefit.config.commands.fit_sections import ViewingConfig
from shapefit.errors import InputError
from shapefit.geometry.pinhole import Camera
from shapefit.io import LandmarkSet
from shapefit.pipelines.fit.camera import all_aside, find_camera

N = 4
MATRIX = np.array([[800.0, 0, 320], [0, 810, 240], [0, 0, 1]])


def images(y_axis="down", **extras):
    return LandmarkSet(
        landmarks=np.zeros((N, 2, 5)),
        landmark_names=tuple("abcde"),
        items=tuple("wxyz"),
        y_axis=y_axis,
        extras=extras,
    )


def camera(images, **keys):
    return find_camera(images, ViewingConfig(model="perspective", **keys))


EACH = MATRIX * np.array([1, 2, 3, 4])[:, None, None]
EACH[:, 2, 2] = 1


@pytest.mark.parametrize(
    ("values", "keys", "focal", "centre"),
    [
        (None, {"focal": 700.0}, [700, 700], [0, 0]),
        (np.float64(700), {}, [700, 700], [0, 0]),
        (np.array([700.0]), {}, [700, 700], [0, 0]),
        (np.full(N, 700.0), {}, [700, 700], [0, 0]),
        (MATRIX, {}, [800, 810], [320, 240]),
        (MATRIX, {"principal_point": (1.0, 2.0)}, [800, 810], [1, 2]),
        (EACH, {}, EACH[:, [0, 1], [0, 1]], EACH[:, :2, 2]),
    ],
    ids=["config", "file", "one", "each", "matrix", "principal point", "matrix of each"],
)
def test_cameras_of_the_config_the_file_or_each_image(values, keys, focal, centre):
    given = {} if values is None else {"f": values}
    found = camera(images(**given), **({"intrinsics": "f"} if given else {}), **keys)
    np.testing.assert_array_equal(found.focal, np.broadcast_to(focal, (N, 2)))
    np.testing.assert_array_equal(found.centre, np.broadcast_to(centre, (N, 2)))


def test_the_sign_is_that_of_the_depth():
    assert camera(images("down"), focal=1.0).sign == 1
    assert camera(images("up"), focal=1.0).sign == -1


SKEWED = MATRIX + np.array([[0, 3.0, 0], [0, 0, 0], [0, 0, 0]])


@pytest.mark.parametrize(
    ("values", "words"),
    [
        (None, ["no such dataset", "true_model"]),
        (np.zeros((N, 2)), ["shape (4, 2)", "4 of them"]),
        (np.array(["a"] * N), ["does not hold numbers"]),
        (SKEWED, ["800 3 320, 0 810 240, 0 0 1", "fx 0 cx"]),
        (MATRIX.T, ["800 0 0, 0 810 0, 320 240 1", "fx 0 cx"]),
        (2 * MATRIX, ["0 0 2", "fx 0 cx"]),
        (-MATRIX + np.diag([0, 0, 2]), ["the focal length -810", "> 0"]),
        (np.array([1.0, 0.0, 1.0, 1.0]), ["the focal length 0", "> 0"]),
        (np.array([1.0, np.nan, 1.0, 1.0]), ["not real or not finite"]),
        (MATRIX * np.array([[1, 1, np.inf]] * 3), ["not real or not finite"]),
        (MATRIX + 0j, ["not real or not finite"]),
    ],
)
def test_what_is_no_camera_is_refused(values, words):
    extras = {"true_model": np.array(["m"] * N)} | ({} if values is None else {"camera": values})
    with pytest.raises(InputError) as error:
        camera(images(**extras), intrinsics="camera")
    for word in ["camera.intrinsics: camera", *words]:
        assert word in str(error.value)


def test_landmarks_without_datasets_want_a_focal_length():
    with pytest.raises(InputError, match=r"give `camera\.focal`, or landmarks in HDF5"):
        camera(images(), intrinsics="camera")


@pytest.mark.parametrize(
    ("shift", "expected"),
    [
        ([640, 480], True),  # the middle of a picture, counted from its corner
        ([-640, 480], True),
        ([640, 0], False),  # to the right of the middle, as a car at the kerb may be
        ([0, 0], False),
        ([150, 150], False),  # near the axis
    ],
)
def test_landmarks_all_far_to_one_side_look_wrong(shift, expected, rng):
    landmarks = rng.uniform(-100, 100, (N, 2, 5)) + np.array(shift)[:, None]
    landmarks[0, :, 0] = np.nan
    found = Camera(np.full((N, 2), 1600.0), np.zeros((N, 2)), 1.0)
    assert all_aside(landmarks, found) is expected
    landmarks[1, :, 2] = -np.array(shift)
    assert not all_aside(landmarks, found)
    assert not all_aside(np.full((N, 2, 5), np.nan), found)


@pytest.mark.parametrize(
    "keys",
    [
        {"model": "perspective"},
        {"focal": 700.0},
        {"model": "weak-perspective", "intrinsics": "K"},
        {"model": "perspective", "focal": 700.0, "intrinsics": "K"},
    ],
)
def test_configs_that_say_too_little_or_too_much(keys):
    with pytest.raises(ValueError, match="focal"):
        ViewingConfig(**keys)
