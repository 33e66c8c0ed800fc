"""The camera: measured, stated about the centre of the image, assumed, or none."""

import numpy as np
import pytest

from shapefit.config import FitConfig
from shapefit.errors import InputError
from shapefit.geometry.pinhole import ASSUMED_FOCAL
from shapefit.io import LandmarkSet
from shapefit.pipelines.fit.camera import Intrinsics, choose_camera

SIZE = np.array([1920, 1080])
MATRIX = np.array([[2500.0, 0, 900], [0, 2600, 500], [0, 0, 1]])
SKEW = np.array([[0, 30.0, 0], [0, 0, 0], [0, 0, 0]])
CENTRE = (960.0, 540.0)
ASSUMED = Intrinsics(ASSUMED_FOCAL * 1920, CENTRE)
OF_FILES = Intrinsics(dataset="camera_matrix")


def box(width=300.0, height=400.0, n=6):
    """Points (n, 2, 4): the corners of a box in each image."""
    corners = np.array([[0, width, 0, width], [0, 0, height, height]], dtype=np.float64)
    return np.tile(np.array([700.0, 300.0])[:, None] + corners, (n, 1, 1))


def images(points=None, unit="px", per_item=None, **whole):
    points = box() if points is None else points
    items = tuple(f"{i:03}" for i in range(len(points)))
    names = tuple("abcdefgh"[: points.shape[2]])
    return LandmarkSet(points, names, items, unit=unit, columns=per_item, whole=whole)


def choose(visible, method="posterior", image_size=None, from_landmarks=False, **camera):
    """Return the intrinsics that were chosen, and the line about them."""
    config = FitConfig(
        landmarks=[__file__],
        output="b.h5",
        method=method,
        camera=camera,
        image_size=image_size,
    )
    found, line = choose_camera(config, visible, from_landmarks=from_landmarks)
    assert line
    return Intrinsics.of(config.changed(camera=found).camera), line


EACH = {"image_size": np.tile(SIZE, (6, 1))}
MIXED = {"image_size": np.arange(1, 13).reshape(6, 2)}
SMALL, LARGE = box(60, 80, n=3), 4 * box(n=1)


@pytest.mark.parametrize(
    ("visible", "keys", "expected", "said"),
    [
        # the image's centre is the principal point wherever a size is known
        (images(image_size=SIZE), {}, ASSUMED, "focal length 2112 px (assumed"),
        (images(per_item=EACH), {}, ASSUMED, "image 1920 x 1080"),
        (images(), {"image_size": (1920, 1080)}, ASSUMED, "image 1920 x 1080"),
        (images(image_size=SIZE), {"focal": 1674}, Intrinsics(1674, CENTRE), "960, 540"),
        (images(), {"focal": 1674, "image_size": (1920, 1080)}, Intrinsics(1674, CENTRE), "540"),
        (
            images(image_size=SIZE),
            {"focal": 1674, "principal_point": (900, 500)},
            Intrinsics(1674, (900, 500)),
            "900, 500",
        ),
        (
            images(image_size=SIZE),
            {"focal": 1674, "method": "convex+refine"},
            Intrinsics(1674, CENTRE),
            "1674 px",
        ),
        # without a size: weak perspective
        (images(), {}, None, "exact positions in metres need --image-size"),
        (images(image_size=np.array([0, 5])), {}, None, "impossible"),
        (images(per_item=MIXED), {}, None, "several sizes"),
        (images(unit="m", image_size=SIZE), {}, None, "not in pixels"),
        (images(box(160, 119.9), image_size=SIZE), {}, None, "cover little"),
        (images(np.concatenate([SMALL, LARGE]), image_size=SIZE), {}, None, "cover little"),
        (images(image_size=SIZE), {"focal": "none"}, None, "weak perspective"),
        (images(image_size=SIZE), {"method": "convex"}, None, "weak perspective"),
        (images(image_size=SIZE), {"from_landmarks": True}, None, "class was learned"),
        # measured cameras are taken as they are
        (images(camera_matrix=MATRIX, image_size=SIZE), {}, OF_FILES, "of the files"),
        (images(camera_matrix=MATRIX), {"focal": "files"}, OF_FILES, "of the files"),
        (
            images(camera_matrix=np.array(1674.0), image_size=SIZE),
            {"focal": "files"},
            Intrinsics(centre=CENTRE, dataset="camera_matrix"),
            "of the files",
        ),
        (
            images(camera_matrix=MATRIX + SKEW),
            {},
            OF_FILES,
            "of the files",
        ),
    ],
)
def test_the_camera(visible, keys, expected, said):
    found, line = choose(visible, **keys)
    assert said in line
    if expected is None or expected.dataset:
        assert found == expected
    else:
        assert found.focal == pytest.approx(expected.focal)
        assert found.centre == expected.centre


@pytest.mark.parametrize(
    ("visible", "keys"),
    [
        (images(), {"focal": 1674}),
        (images(), {"focal": 1674, "method": "convex+refine"}),
        (images(per_item=MIXED), {"focal": 1674}),
        (images(camera_matrix=np.array(1674.0)), {"focal": "files"}),
    ],
)
def test_a_focal_length_without_a_size_asks_for_it(visible, keys):
    with pytest.raises(InputError, match="--image-size WxH"):
        choose(visible, **keys)


def test_an_impossible_matrix_is_an_error():
    with pytest.raises(InputError):
        choose(images(camera_matrix=MATRIX * [[-1.0], [1], [1]]))
