"""The JSON file has COCO's layout, 3D points beside those of the image, and says its units."""

import json

import numpy as np
import pytest

from shapefit.io.layout import LANDMARKS, RESULTS, SHAPES
from shapefit.io.records import LandmarkSet
from shapefit.io.writing import record_writer


def write(path, form, *records):
    with record_writer(path, form) as writer:
        for record in records:
            writer.append(record)
    content = json.loads(path.read_text(encoding="utf-8"))
    assert [each["id"] for each in content["annotations"]] == list(
        range(1, len(content["annotations"]) + 1)
    )
    images = {image["id"]: image for image in content["images"]}
    assert {each["image_id"] for each in content["annotations"]} == images.keys()
    return content, images


@pytest.fixture
def landmarks(rng) -> LandmarkSet:
    points = rng.uniform(0, 100, size=(4, 2, 3))
    points[1, :, 2] = np.nan
    points[3] = np.nan
    return LandmarkSet(
        landmarks=points,
        confidence=np.array([[0.5, 1, 0], [1, 1, 1], [1, 1, 1], [1, 1, 1]]),
        landmark_names=("nose", "left eye", "tail"),
        items=("film/anna/img 0", "film/bob/img 0", "film/anna/img 1", "film/bob/img 1"),
        sequences=("film/anna", "film/bob") * 2,
        unit="px",
        y_axis="down",
        frame_rate=30.0,
        columns={"frame": np.array([0, 0, 1, 1]), "edges": np.array([[0, 1], [0, 2]])},
    )


@pytest.mark.parametrize("y_axis", ["down", "up"])
def test_landmarks_as_annotations(tmp_path, landmarks, y_axis):
    if y_axis == "up":  # as COCO's y is down, it is turned
        turned = landmarks.landmarks * np.array([[1], [-1]])
        given = landmarks.replaced(landmarks=turned, y_axis="up")
    else:
        given = landmarks
    parts = given.take([0, 1]), given.take([2, 3])
    content, images = write(tmp_path / "film.json", LANDMARKS, *parts)
    (category,) = content["categories"]
    assert category["keypoints"] == ["nose", "left eye", "tail"]
    assert category["skeleton"] == [[1, 2], [1, 3]]
    assert (content["info"]["unit"], content["info"]["y_axis"]) == ("px", "down")
    assert content["info"]["frame_rate"] == 30
    anna, bob, *_, empty = content["annotations"]
    assert anna["image_id"] == bob["image_id"]
    assert images[anna["image_id"]]["file_name"] == "film/img 0"
    assert len(images) == 2
    found = np.array(anna["keypoints"]).reshape(3, 3)
    np.testing.assert_allclose(found[:2, :2], landmarks.landmarks[0].T[:2])
    np.testing.assert_array_equal(found[:, 2], [2, 2, 0])  # no confidence: not seen
    np.testing.assert_array_equal(found[2], 0)
    assert anna["num_keypoints"] == 2
    assert anna["confidence"] == [0.5, 1, 0]
    x, y, width, height = anna["bbox"]
    least, most = found[:2, :2].min(axis=0), found[:2, :2].max(axis=0)
    np.testing.assert_allclose([x, y, x + width, y + height], [*least, *most])
    assert anna["area"] == pytest.approx(width * height)
    assert (empty["num_keypoints"], empty["bbox"]) == (0, [0, 0, 0, 0])


def test_results_keep_their_unit_and_say_what_metres_are(tmp_path, scene, facing):
    result = scene.result
    n, p = len(result), len(result.landmark_names)
    seen = np.arange(n * p * 2, dtype=float).reshape(n, p, 2)
    seen[0, 0] = np.nan
    result = result.replaced(
        further=result.further | {"landmarks": seen},
        shape_sd=np.full((n, 3, p), 0.5),
        status=np.array(["converged"] * n),
    )
    content, _ = write(tmp_path / "man.json", RESULTS, result)
    assert content["info"]["unit_3d"] == "px"
    assert content["info"]["axes_3d"] == "x right, y down, z away from the camera"
    for row, each in enumerate(content["annotations"]):
        points = np.array(each["keypoints_3d"]).reshape(p, 3)
        np.testing.assert_array_equal(points, result.shapes[row].T)
        assert each["keypoints_3d_sd"] == [0.5] * (3 * p)
        assert each["metres_per_unit"] == result.columns["metres_per_unit"][row]
        assert each["status"] == "converged"
        assert each["item"] == result.items[row]
    assert content["annotations"][0]["keypoints"][:3] == [0, 0, 0]
    assert content["annotations"][1]["keypoints"][:3] == [30, 31, 2]
    up, _ = write(tmp_path / "up.json", RESULTS, facing(result, "up"))
    for one, other in zip(up["annotations"], content["annotations"], strict=True):
        np.testing.assert_array_equal(one["keypoints_3d"], other["keypoints_3d"])


def test_unknown_points_are_null(tmp_path, shapes):
    points = shapes.shapes.copy()
    points[0, :, 1] = np.nan
    content, images = write(tmp_path / "walk.json", SHAPES, shapes.replaced(shapes=points))
    first = content["annotations"][0]
    assert first["keypoints_3d"][3:6] == [None] * 3
    assert "keypoints" not in first
    assert content["info"]["unit_3d"] == "cm"
    assert images[1]["file_name"] == "film/anna/0"


def test_no_items(tmp_path, landmarks):
    content, _ = write(tmp_path / "none.json", LANDMARKS, landmarks.take([]))
    assert content["annotations"] == []
    assert content["categories"][0]["keypoints"] == list(landmarks.landmark_names)
