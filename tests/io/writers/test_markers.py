"""Landmarks of a detector, written as markers."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from shapefit.errors import InputError
from shapefit.records import Fit
from tests.columns import put
from tests.geometry import test_floor as planted
from tests.io.files import load_shapes, save
from tests.io.writers.conftest import parse_trc, trc_points
from tests.io.writers.test_floor import seen


@pytest.fixture
def walk() -> Fit:
    return seen(planted.walk())


DETECTED = {"RHip": "rhip", "LHip": "lhip", "MidHip": "rhip", "Nose": "rshoulder"}
"""Landmark of a detector -> the joint above which it is."""


@pytest.fixture
def lifted(walk) -> Fit:
    """Return the walk with four landmarks of a detector, 1 cm above joints."""
    columns = [planted.JOINTS[joint] for joint in DETECTED.values()]
    points = walk.shapes[:, columns]
    points[..., 1] -= 0.01 / walk.column("metres_per_unit")[:, None]
    markers = {
        "input_shapes": points,
        "input_shape_sd": np.full_like(points, 2.0),
        "input_landmark_names": np.array(list(DETECTED), dtype=object),
        "landmarks_fitted": walk.shapes[..., :2],
    }
    return put(walk, markers)


def test_markers_have_the_names_that_models_of_pose2sim_know(tmp_path, lifted):
    path = tmp_path / "man.trc"
    save(path, lifted, markers="input")
    assert parse_trc(path).names == ["RHip", "LHip", "CHip", "Nose"]


def test_markers_are_where_the_detector_has_them(tmp_path, lifted):
    save(tmp_path / "joints.trc", lifted)
    save(tmp_path / "man.trc", lifted, markers="input")
    markers = trc_points(tmp_path / "man.trc")
    joints = trc_points(tmp_path / "joints.trc")
    above_hip = markers[..., 0] - joints[..., planted.JOINTS["rhip"]]
    distances = np.linalg.norm(above_hip, axis=1)
    assert_allclose(distances, 0.01, atol=1e-6)


def test_markers_come_back(tmp_path, lifted):
    path = tmp_path / "man.trc"
    save(path, lifted, markers="input")
    shapes, _ = load_shapes(path)
    assert_allclose(shapes.as_columns(), trc_points(path), atol=1e-12)


def test_angles_are_those_of_joints(tmp_path, lifted):
    save(tmp_path / "joints.trc", lifted)
    save(tmp_path / "man.trc", lifted, markers="input")
    angles = (tmp_path / "man_angles.csv").read_bytes()
    assert angles == (tmp_path / "joints_angles.csv").read_bytes()


def test_bvh_has_markers_too(tmp_path, lifted):
    path = tmp_path / "man.bvh"
    save(path, lifted, markers="input")
    shapes, _ = load_shapes(path)
    assert {"CHip", "RHip"} <= set(shapes.landmark_names)


def test_markers_of_coco_have_the_names_of_models(tmp_path, lifted):
    path = tmp_path / "man.trc"
    names = np.array(["right_hip", "left_hip", "nose", "left_ear"], dtype=object)
    of_coco = put(lifted, {"input_landmark_names": names})
    save(path, of_coco, markers="input")
    assert parse_trc(path).names == ["RHip", "LHip", "Nose", "LEar"]


def test_without_landmarks_of_a_detector_there_are_no_markers(tmp_path, walk):
    with pytest.raises(InputError, match="lift them with `posterior` or `sequences`"):
        save(tmp_path / "man.trc", walk, markers="input")
