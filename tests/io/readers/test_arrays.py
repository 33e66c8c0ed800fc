"""Arrays: zeros, fractions of an image, and points in 3D."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from shapefit.errors import InputError
from shapefit.io import open_shapes
from shapefit.io.checks import warn_of_zeros
from shapefit.io.options import InputOptions
from shapefit.io.source import find_kind

from .made import read_images as read
from .made import write_mediapipe


@pytest.fixture
def points(rng) -> np.ndarray:
    """Five frames of four landmarks in pixels."""
    return np.round(rng.uniform(1, 600, (5, 4, 2)), 3)


@pytest.fixture
def with_zeros(points):
    """Points, of which one landmark is at (0, 0) in three frames."""
    points[::2, 1] = 0
    return points


def test_many_landmarks_at_zero_are_a_warning(tmp_path, with_zeros):
    path = tmp_path / "a.npy"
    np.save(path, np.tile(with_zeros, (5, 1, 1)))
    _, (note,) = read(path)
    assert "15 of 100 landmarks are at exactly (0, 0)" in note


def test_many_landmarks_of_a_table_at_zero_are_a_warning(table, with_zeros):
    rows = ["item,landmark,x,y"]
    for item, image in enumerate(with_zeros):
        for landmark, (x, y) in enumerate(image):
            rows.append(f"{item},{landmark},{x},{y}")
    _, (note,) = read(table("\n".join(rows), "a.csv"))
    assert "a.csv: 3 of 20 landmarks are at exactly (0, 0)" in note


@pytest.mark.parametrize("y_sign", [1, -1])
def test_landmarks_at_zero_are_missing_only_in_a_corner(points, y_sign):
    """Whoever places a landmark at the origin has others on both sides of it."""
    pixels = 1 + np.abs(points) * [1, y_sign]
    centred = pixels - pixels.mean(axis=1, keepdims=True)
    pixels[:, 1] = 0
    centred[:, 1] = 0
    assert len(warn_of_zeros(pixels)) == 1
    assert warn_of_zeros(centred) == ()


def test_images_of_nobody_are_a_warning():
    assert warn_of_zeros(np.zeros((3, 5, 2))) != ()


def write_fractions_as_array(path, points):
    np.save(path, points)


def write_fractions_as_list(path, points):
    write_mediapipe(path, points[:, None], np.ones((3, 1, 33)))


def write_fractions_as_table(path, points):
    names = [f"{axis}{n}" for n in range(33) for axis in "xyzv"]
    depth_and_visibility = np.ones((3, 33, 2))
    cells = np.concatenate([points, depth_and_visibility], axis=2).reshape(3, -1)
    rows = [",".join(map(str, row)) for row in [names, *cells]]
    path.write_text("\n".join(rows), encoding="utf-8")


FRACTIONS = {
    "a.npy": write_fractions_as_array,
    "a.json": write_fractions_as_list,
    "a.csv": write_fractions_as_table,
}


@pytest.fixture(params=FRACTIONS)
def fractions(request, tmp_path, rng):
    """A file of fractions of an image, and these."""
    points = np.round(rng.uniform(size=(3, 33, 2)), 3)
    path = tmp_path / request.param
    FRACTIONS[request.param](path, points)
    return path, points


def test_fractions_of_an_image_need_its_size(fractions):
    path, _ = fractions
    fault = r"fractions of the width.*`image_size=\[1920,1080"
    with pytest.raises(InputError, match=fault):
        read(path, keypoints="mediapipe_33")


def test_fractions_of_an_image_become_pixels(fractions):
    path, points = fractions
    width, height = 200.0, 100.0
    images, _ = read(path, keypoints="mediapipe_33", image_size=(width, height))
    expected = points * (width, height)
    assert_allclose(images.landmarks, expected)
    assert images.unit == "px"
    assert images.landmark_names[0] == "nose"


@pytest.fixture
def array(tmp_path):
    """Write an array and return its path."""

    def write(points):
        path = tmp_path / "a.npy"
        np.save(path, points)
        return path

    return write


COCO = InputOptions(keypoints="coco_17")


@pytest.mark.parametrize("scale", [1.0, 1000.0])
def test_arrays_of_3d_points_are_shapes(array, rng, scale):
    points = scale * rng.uniform(-1, 1, (6, 17, 3))
    path = array(points)
    with open_shapes([path], COCO) as source:
        shapes = source.whole()
    assert find_kind(path, COCO) == "shapes"
    assert shapes.landmark_names[0] == "nose"
    assert_array_equal(shapes.shapes, points)
    with pytest.raises(InputError, match=r"third numbers run.*3D are for learn-dict"):
        read(path, keypoints="coco_17")


def test_arrays_whose_third_number_may_be_either_ask_for_the_format(array, rng):
    path = array(rng.uniform(0, 1, (6, 17, 3)))
    with pytest.raises(InputError, match=r"image_size.*or `format=arrays-3d` if the"):
        read(path, keypoints="coco_17")


def test_the_format_says_what_the_third_number_is(array, rng):
    path = array(rng.uniform(0, 1, (6, 17, 3)))
    options = InputOptions(keypoints="coco_17", format="arrays-3d")
    assert find_kind(path, options) == "shapes"


def test_where_shapes_are_asked_for_the_third_number_is_a_depth(array, rng):
    points = rng.uniform(0, 1, (6, 17, 3))
    with open_shapes([array(points)], COCO) as source:
        assert_array_equal(source.whole().shapes, points)
