"""Calibrations in the TOML, YAML and JSON of several tools."""

import json

import h5py
import numpy as np
import pytest
from numpy.testing import assert_allclose

from shapefit.errors import InputError
from shapefit.io.readers.calibration import read_camera

TWO = """
[cam_0]
name = "left"
size = [640, 480]
matrix = [[500.0, 0.0, 320.0], [0.0, 501.0, 240.0], [0.0, 0.0, 1.0]]
distortions = [-0.1, 0.01, 0.001, 0.002, 0.0]
rotation = [0.0, 0.0, 1.5707963267948966]
translation = [1.0, 2.0, 3.0]

[cam_1]
port = 7
size = [640, 480]
matrix = [[500, 1e-4, 320], [0, 500, 240], [0, 0, 1]]  # but for rounding
distortions = [-0.1, 0.01, 0.001, 0.002]
rotation = [[0, -1, 0], [1, 0, 0], [0, 0, 1]]
translation = [1, 2, 3]

[metadata]
error = 0.3
"""


@pytest.fixture
def calibration(tmp_path):
    def make(text=TWO):
        path = tmp_path / "calibration.toml"
        path.write_text(text)
        return path

    return make


@pytest.mark.parametrize("name", ["cam_0", "left", "cam_1", "7"])
def test_by_section_name_or_port_and_rotations_of_both_kinds(calibration, name):
    camera = read_camera(calibration(), name)
    assert_allclose(camera.rotation, [[0, -1, 0], [1, 0, 0], [0, 0, 1]], atol=1e-12)
    assert_allclose(camera.distortion, [-0.1, 0.01, 0.001, 0.002, 0, 0, 0, 0])
    assert camera.size.tolist() == [640, 480]
    assert camera.translation.tolist() == [1, 2, 3]


def test_a_lens_of_one_coefficient(calibration):
    text = TWO.replace("-0.1, 0.01, 0.001, 0.002, 0.0]", "-0.1]")
    assert read_camera(calibration(text), "left").distortion.tolist() == [
        -0.1,
        *[0] * 7,
    ]


def test_the_only_camera_needs_no_name_and_may_lack_a_place(calibration):
    text = "[cameras.3]\nmatrix = [[0.8, 0, 0.5], [0, 0.9, 0.4], [0, 0, 1]]\nport = 3\n"
    camera = read_camera(calibration(text), None)
    assert camera.matrix.tolist() == [[0.8, 0, 0.5], [0, 0.9, 0.4], [0, 0, 1]]
    assert camera.rotation is None
    assert not camera.distortion.any()


OPENCV = """%YAML:1.0
---
image_width: 640
image_height: 480
camera_matrix: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 5.0e+02, 0., 3.2e+02, 0., 501., 240., 0., 0., 1. ]
distortion_coefficients: !!opencv-matrix
   rows: 5
   cols: 1
   dt: d
   data: [ -0.1, 0.01, 0.001, 0.002, 0. ]
"""
ROS = OPENCV.replace(
    "%YAML:1.0\n---\n", "camera_name: left\ndistortion_model: plumb_bob\n"
).replace(" !!opencv-matrix", "")
MATRIX = [[500, 0, 320], [0, 501, 240], [0, 0, 1]]
STATED = [-0.1, 0.01, 0.001, 0.002, 0]
STORED = {"type_id": "opencv-matrix", "dt": "d"}
OPENCV_JSON = {
    "image_width": 640,
    "image_height": 480,
    "camera_matrix": {
        **STORED,
        "rows": 3,
        "cols": 3,
        "data": np.ravel(MATRIX).tolist(),
    },
    "distortion_coefficients": {**STORED, "rows": 1, "cols": 5, "data": STATED},
}
PANOPTIC = {
    "cameras": [
        {"name": "00", "K": np.eye(3).tolist()},
        {
            "name": "01",
            "K": MATRIX,
            "distCoef": STATED,
            "resolution": [640, 480],
            "R": np.eye(3).tolist(),
            "t": [[1], [2], [3]],
        },
    ]
}


@pytest.mark.parametrize(
    ("file", "text", "name"),
    [
        ("left.yml", OPENCV, None),
        ("left.yaml", ROS, None),
        ("left.json", json.dumps(OPENCV_JSON), None),
        (
            "left.json",
            json.dumps({"mtx": MATRIX, "dist": [STATED], "size": [640, 480]}),
            None,
        ),
        ("rig.json", json.dumps(PANOPTIC), "01"),
    ],
)
def test_yaml_and_json_of_opencv(tmp_path, file, text, name):
    (tmp_path / file).write_text(text)
    camera = read_camera(tmp_path / file, name)
    assert camera.matrix.tolist() == MATRIX
    assert camera.distortion.tolist() == [*STATED, 0, 0, 0]
    assert camera.size.tolist() == [640, 480]
    assert camera.translation is None or camera.translation.tolist() == [1, 2, 3]


BOMB = "a: &a [1]\n" + "".join(
    f"{b}: &{b} [*{a}, *{a}, *{a}, *{a}, *{a}, *{a}, *{a}]\n"
    for a, b in zip("abcdefghijk", "bcdefghijkl", strict=True)
)


@pytest.mark.parametrize(
    ("file", "text", "words"),
    [
        ("a.yml", "%YAML:1.0\n---\nK: [", "cannot be read as a calibration"),
        ("a.yml", "%YAML:1.0\n---\n" + "[" * 50_000, "lists nested too deeply"),
        ("a.yml", BOMB, "an anchor or an alias"),
        ("a.json", '{"K": [', "is not whole JSON"),
        (
            "a.json",
            '{"K": [[1, 0], [0, 1]]}',
            "matrix is [[1, 0], [0, 1]], not 3 x 3 numbers",
        ),
        (
            "a.yml",
            OPENCV.replace("rows: 3", "rows: x"),
            "matrix has 9 numbers, not x rows of 3",
        ),
        ("a.yml", ROS.replace("plumb_bob", "equidistant"), "a fisheye lens"),
    ],
)
def test_yaml_and_json_that_are_no_calibration(tmp_path, file, text, words):
    (tmp_path / file).write_text(text)
    with pytest.raises(InputError) as error:
        read_camera(tmp_path / file, None)
    assert words in str(error.value)


@pytest.mark.parametrize(
    ("text", "name", "words"),
    [
        (TWO, None, ["2 cameras", "cam_0 or left and cam_1 or 7"]),
        (TWO, "right", ["no camera 'right'", "cam_0 or left and cam_1 or 7"]),
        ("[metadata]\nerror = 1\n", None, ["no section with the `matrix`"]),
        (
            "matrix = [",
            None,
            ["cannot be read as a calibration", "give the calibration of anipose"],
        ),
        (
            TWO.replace("500.0, 0.0, 320.0", "500.0, 3.0, 320.0"),
            "left",
            ["cam_0", "500 3 320"],
        ),
        (
            TWO.replace("500.0, 0.0, 320.0", "-500.0, 0.0, 320.0"),
            "left",
            ["cam_0", "-500"],
        ),
        (TWO.replace("[0.0, 0.0, 1.57", "[0.0, 1.57"), "left", ["cam_0", "rotation"]),
        (TWO.replace("[[0, -1, 0]", "[[0, 1, 0]"), "7", ["cam_1", "rotation"]),
        (TWO.replace("[[0, -1, 0]", "[[0, -2, 0]"), "7", ["cam_1", "rotation"]),
        (
            TWO.replace("0.002, 0.0]", "0.002, 'a']"),
            "left",
            ["cam_0", "distortion are not all numbers"],
        ),
        (TWO.replace("0.002, 0.0]", "0.002, 0.0, 1.0]"), "left", ["6 coefficients"]),
        (TWO.replace("[1.0, 2.0", "[1.0, nan"), "left", ["translation is [1.0, nan"]),
        (
            TWO.replace("0.002, 0.0]", "0, 0, 0, 0, 0, 1]"),
            "left",
            ["9 coefficients", "prism"],
        ),
        (
            TWO.replace('name = "left"', 'name = "left"\nfisheye = true'),
            "left",
            ["fisheye"],
        ),
    ],
)
def test_errors_name_what_is_wrong(calibration, text, name, words):
    with pytest.raises(InputError) as error:
        read_camera(calibration(text), name)
    assert all(word in str(error.value) for word in words), error.value


@pytest.mark.real_data
def test_real_calibrations_equal_what_others_read(real_data):
    """The file of the flies is in millimetres, the landmarks beside it in metres."""
    for file, name, landmarks, before, size in [
        ("fly/calibration.toml", "Cam-A", "fly/Cam-A.h5", "", 1000),
        (
            "pose2sim_balancing/Calib_qualisys.toml",
            "cam_03",
            "pose2sim_balancing/cam03.h5",
            "published_",
            1,
        ),
    ]:
        camera = read_camera(real_data / "detected" / file, name)
        with h5py.File(real_data / "detected" / landmarks) as known:
            rotation = known[f"{before}extrinsic_rotation"][()]
            translation = known[f"{before}extrinsic_translation"][()]
            assert_allclose(camera.matrix, known["camera_matrix"][()])
        assert_allclose(camera.rotation, rotation, atol=1e-12)
        assert_allclose(camera.translation / size, translation, rtol=1e-9)
