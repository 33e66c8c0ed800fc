"""Markers in a plane are landmarks of images."""

from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from shapefit.errors import InputError
from shapefit.io.source import find_kind
from tests.io.files import load_shapes

from .made import read_images
from .test_trc import HEAD, TRC
from .test_vicon import HEADER as VICON_HEADER

PLANE = np.array([[[n, -20, 0], [40, -50 - n, 0]] for n in range(3)], float)
"""Three frames of two points whose y is below 0."""


NAMES = ("knee", "ankle")


def write_plane_as_trc(path, plane):
    lines = [HEAD.replace("mm", "px").removesuffix("\n")]
    for frame, points in enumerate(plane):
        row = [frame, frame / 50, *points.ravel()]
        lines.append("\t".join(map(str, row)))
    path.write_text("\n".join([*lines, ""]))


def write_plane_as_vicon(path, plane):
    lines = [VICON_HEADER.replace("mm", "px").removesuffix("\n")]
    for frame, points in enumerate(plane):
        row = [frame, 0, *points.ravel()]
        lines.append(",".join(map(str, row)))
    path.write_text("\n".join([*lines, ""]))


def write_plane_as_c3d(path, plane):
    ezc3d = pytest.importorskip("ezc3d", reason="ezc3d is the extra `c3d`")
    file = ezc3d.c3d()
    parameters = file["parameters"]["POINT"]
    parameters["LABELS"]["value"] = list(NAMES)
    parameters["UNITS"]["value"] = ["px"]
    parameters["RATE"]["value"] = [50.0]
    points = np.ones((4, 2, 3))
    points[:3] = plane.transpose(2, 1, 0)
    file["data"]["points"] = points
    file.write(str(path))


def write_plane_as_table(path, plane):
    lines = ["frame;landmark;x;y;z"]
    for frame, points in enumerate(plane):
        for name, point in zip(NAMES, points, strict=True):
            lines.append(";".join(map(str, [frame, name, *point])))
    path.write_text("\n".join([*lines, ""]))


MARKER_FILES = {
    "walk.trc": write_plane_as_trc,
    "walk.c3d": write_plane_as_c3d,
    "walk.csv": write_plane_as_vicon,
}
"""Files of markers, whose y points up."""


@pytest.fixture
def write_plane(tmp_path):
    """Write a plane as the file of this name."""

    def write(name: str, plane: np.ndarray) -> Path:
        path = tmp_path / name
        writers = MARKER_FILES | {"table.csv": write_plane_as_table}
        writers[name](path, plane)
        return path

    return write


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("name", [*MARKER_FILES, "table.csv"])
def test_points_in_a_plane_are_landmarks_and_no_shapes(write_plane, name, sign):
    path = write_plane(name, PLANE * [1.0, sign, 1.0])
    _, notes = read_images(path)
    ends = "z is 0 everywhere: x and y are read as landmarks"
    assert find_kind(path) == "landmarks"
    assert any(note.endswith(ends) for note in notes)
    with pytest.raises(InputError, match="of 2D points: z is 0 everywhere; give 3D sh"):
        load_shapes(path)


@pytest.mark.parametrize("name", MARKER_FILES)
def test_negative_pixels_of_markers_are_negated(write_plane, name):
    """As Sports2D writes the landmarks of an image."""
    images, notes = read_images(write_plane(name, PLANE))
    expected = PLANE[..., :2] * [1, -1]
    assert_array_equal(images.landmarks, expected)
    assert images.y_axis == "down"
    assert images.unit == "px"
    assert notes[-1].endswith("its sign is changed: y points down")


@pytest.mark.parametrize("name", MARKER_FILES)
def test_y_of_markers_points_up(write_plane, name):
    positive = PLANE * [1.0, -1.0, 1.0]
    images, notes = read_images(write_plane(name, positive))
    assert_array_equal(images.landmarks, positive[..., :2])
    assert images.y_axis == "up"
    assert images.unit == "px"
    assert notes[-1].endswith("y points up, as that of markers")


@pytest.mark.parametrize("sign", [1, -1])
def test_a_table_does_not_say_where_y_points(write_plane, sign):
    plane = PLANE * [1.0, sign, 1.0]
    images, notes = read_images(write_plane("table.csv", plane))
    assert_array_equal(images.landmarks, plane[..., :2])
    assert images.y_axis == "down"
    assert images.unit == "unknown"
    assert "y points" not in notes[-1]


def test_negative_pixels_stay_where_y_is_said_to_point_up(write_plane):
    path = write_plane("walk.trc", PLANE)
    images, _ = read_images(path, y_axis="up")
    assert_array_equal(images.landmarks, PLANE[..., :2])
    assert images.y_axis == "up"


def test_markers_in_space_are_no_landmarks(tmp_path):
    path = tmp_path / "walk.trc"
    path.write_text(TRC)
    with pytest.raises(InputError, match="of 3D points; give 2D landmarks"):
        read_images(path)
