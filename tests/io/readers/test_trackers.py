"""Each format of a tracker gives back the points that it was made of."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from shapefit.io import read_shapes
from tests.io.readers import made
from tests.io.readers.made import TRACKERS, landmark_names


def by_animal(images, many: int) -> np.ndarray:
    """Return points (frames, individuals, landmarks, 2) of items sorted by sequence."""
    points = images.landmarks
    return np.moveaxis(points.reshape(many, -1, *points.shape[1:]), 0, 1)


WITHOUT_JABS = [name for name in TRACKERS if "_pose_est_" not in name]


@pytest.mark.parametrize("many", [1, 2])
@pytest.mark.parametrize("name", WITHOUT_JABS)
def test_points_confidence_and_names(tmp_path, points, confidence, read, name, many):
    path = tmp_path / name
    points = points[:, :many]
    confidence = confidence[:, :many]
    TRACKERS[name](path, points, confidence)
    images = read(path)
    seen = np.isfinite(points[..., 0])
    weights = np.moveaxis(np.where(seen, confidence, 0), 1, 0).reshape(-1, 4)
    assert_array_equal(by_animal(images, many), points)
    assert_allclose(images.confidence, weights)
    assert images.landmark_names == landmark_names(4)
    assert len(set(images.sequences)) == many
    assert images.unit == "px"
    assert images.y_axis == "down"


@pytest.mark.parametrize(
    ("many", "items"),
    [(1, ("table/0", "table/1")), (2, ("table/animal0/0", "table/animal0/1"))],
)
def test_items_of_several_animals_name_them(
    tmp_path, points, confidence, read, many, items
):
    path = tmp_path / "table.csv"
    TRACKERS["table.csv"](path, points[:, :many], confidence[:, :many])
    assert read(path).items[:2] == items


WITH_SHAPES = ["table.csv", "table.h5", "fixed.h5", "poses.nc", "poses.nwb"]


@pytest.mark.parametrize("name", WITH_SHAPES)
def test_three_dimensions_are_shapes(tmp_path, rng, confidence, name, problem):
    path = tmp_path / name
    points = rng.normal(size=(7, 2, 4, 3))
    points[0, 0, 1] = np.nan
    TRACKERS[name](path, points, confidence)
    shapes = read_shapes([path], gaps=True).shapes
    by_frame = np.moveaxis(shapes.reshape(2, 7, 4, 3), 0, 1)
    assert_array_equal(by_frame, points)
    assert "of 3D points; give 2D landmarks" in problem(path)


def test_movement_of_newer_versions(tmp_path, points, confidence, read):
    path = tmp_path / "p.nc"
    made.write_movement(path, points, confidence, plural=False)
    assert_array_equal(by_animal(read(path), 2), points)
