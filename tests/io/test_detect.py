"""The format of a file by its content; files that are no recordings are named for what
they are.
"""

import gzip
import json
import pickle

import h5py
import numpy as np
import pytest

from shapefit.errors import InputError
from shapefit.io import inputs, open_landmarks
from shapefit.io.detect import FORMATS, detect_format
from shapefit.io.options import InputOptions
from shapefit.io.source import find_kind

LONG = np.arange(3 * 2000.0).tolist()
PAIRS = np.arange(2 * 2000.0).reshape(-1, 2).tolist()
POINT = {"x": 0.5, "y": 0.25, "z": 0.0}


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("openpose", {"people": [{"pose_keypoints_2d": LONG}], "version": 1.3}),
        ("openpose", {"version": 1.3}),
        (
            "coco-annotations",
            {"info": {"version": "1.0"}, "annotations": [], "images": []},
        ),
        ("coco-results", [{"keypoints": LONG, "image_id": 1}]),
        ("mmpose-images", [{"keypoints": PAIRS, "keypoint_scores": LONG}]),
        ("mmpose-images", []),
        ("mmpose-video", [{"frame_id": 0, "instances": []}]),
        ("mmpose-video", {"instance_info": [], "meta_info": {}}),
        ("mediapipe", {"frames": [{"landmarks": [[POINT]]}]}),
        ("mediapipe", {"0": [{"name": "nose", **POINT}]}),
        ("arrays", [[[1, 2], [3, 4]]]),
        ("arrays", [[None, 2], [3, 4]]),
    ],
)
def test_json_by_its_keys(tmp_path, name, content):
    path = tmp_path / "0.json"
    path.write_text(json.dumps(content))
    assert detect_format(path) is FORMATS[name]


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ('{"people": [', ":1: is not whole JSON"),
        (
            '{"entries": [{"a": {"at": 0, "x": 1, "y": 2}}]}',
            "of no known kind, with entries",
        ),
        ('[{"shapes": [], "imagePath": ""}]', "imagePath"),
    ],
)
def test_json_that_is_not_of_a_detector(tmp_path, text, found):
    path = tmp_path / "0.json"
    path.write_text(text)
    with pytest.raises(InputError) as error:
        detect_format(path)
    assert found in str(error.value)


@pytest.mark.parametrize(
    ("further", "name"),
    [
        ("", "csv"),
        (",confidence,sequence", "csv"),
        (",person_id", "table"),
        (",id", "table"),
    ],
)
def test_a_table_with_a_column_of_individuals_is_none_of_ours(tmp_path, further, name):
    path = tmp_path / "landmarks.csv"
    path.write_text(f"item,landmark,x,y{further}\n")
    assert detect_format(path) is FORMATS[name]


# What is no recording

TEXT = b"scorer,a,a,a\nbodyparts,nose,nose,nose\ncoords,x,y,likelihood\n0,1,2,0.5\n"


def refusal(path) -> str:
    with pytest.raises(InputError) as error, open_landmarks([path]):
        pass
    text = str(error.value)
    assert text.startswith(str(path))
    assert "\n" not in text
    return text


@pytest.mark.parametrize("name", ["walk.json", "walk.csv", "walk.csv.gz", "walk"])
@pytest.mark.parametrize(
    "content",
    [gzip.compress(b"\0" + TEXT), pickle.dumps({"weight": 1}, 2), b"CDF\2" + bytes(60)],
    ids=[
        "gzip of no text",
        "pickle",
        "netcdf 3",
    ],  # contents hold the time, and make no stable names
)
def test_files_that_are_not_text(tmp_path, name, content):
    path = tmp_path / name
    path.write_bytes(content)
    assert "neither text nor of a known format; give the landmarks that a" in refusal(
        path
    )


TIDY = b"item,landmark,x,y\ni,a,250,5\ni,b,75,125\n"
WIDE = b"frame,track_id,nose_x,nose_y,hip_x,hip_y\n0,1,10,20,30,50\n0,2,11,21,31,51\n"
ARRAY = b"[[[1,2],[3,4]]]"


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("t.csv", TIDY),
        ("w.csv", WIDE),
        ("d.csv", TEXT),
        ("a.json", ARRAY),
        ("bare", TIDY),
    ],
)
def test_text_that_gzip_made_smaller(tmp_path, monkeypatch, name, content):
    (tmp_path / name).write_bytes(content)
    packed = tmp_path / f"{name}.gz"
    packed.write_bytes(gzip.compress(content))
    options = InputOptions(keypoints="numbered")
    plain, found = (whole(path, options) for path in (tmp_path / name, packed))
    np.testing.assert_array_equal(found.landmarks, plain.landmarks)
    assert (found.items, found.sequences) == (plain.items, plain.sequences)
    assert detect_format(packed) is detect_format(tmp_path / name)
    packed.write_bytes(gzip.compress(content)[:-8])  # cut off
    assert "cannot be unpacked" in refusal(packed)
    packed.write_bytes(gzip.compress(content + b" " * 5_000_000))
    assert packed.stat().st_size < 10_000
    monkeypatch.setattr(inputs, "LARGEST_BYTES", 1_000_000)
    if content != TIDY:  # which is read block by block
        assert "more than 1 MB of text, and it is read whole" in refusal(packed)


def whole(path, options):
    with open_landmarks([path], options) as source:
        return source.whole()


@pytest.mark.parametrize(
    ("name", "content"),
    [
        (
            "calibration.toml",
            '[cam_0]\nname = "A"\nmatrix = [[1.0, 0.0], [0.0, 1.0]]\n',
        ),
        (
            "calibration.yaml",
            "%YAML:1.0\n---\ncamera_matrix: !!opencv-matrix\n   rows: 3\n",
        ),
        ("calibration.json", '{"cam_0": {"matrix": [[1, 0], [0, 1]], "size": [3, 4]}}'),
        ("cameras", "[cam_0]\nmatrix = [[1.0]]\n"),
        ("cameras", "%YAML:1.0\n---\ncamera_matrix: !!opencv-matrix\n"),
        ("cameras", '{"cam_0": {"matrix": [[1, 0], [0, 1]], "size": [3, 4]}}'),
    ],
)
def test_a_calibration_is_no_file_of_landmarks(tmp_path, name, content):
    path = tmp_path / name
    path.write_text(content)
    assert "is a calibration of cameras, not landmarks; give it as --cal" in refusal(
        path
    )


@pytest.mark.parametrize(
    ("line", "found"),
    [
        ("scorer;a;a;a", "cannot be read as a DeepLabCut"),
        (
            "track,frame_idx,instance.score,nose.x,nose.y,nose.score",
            "the header is 'track,frame_",
        ),
    ],
)
def test_tables_of_another_kind(tmp_path, line, found):
    path = tmp_path / "walk.csv"
    path.write_text(f"{line}\n")
    assert found in refusal(path)


def test_hdf5_of_another_kind_says_what_was_looked_for(tmp_path):
    path = tmp_path / "poses.h5"
    with h5py.File(path, "w") as file:
        file["data"] = np.zeros((3, 3, 4))
    text = refusal(path)
    for name in (
        "shapefit-landmarks",
        "DeepLabCut",
        "SLEAP",
        "JABS",
        "NWB",
        "movement",
    ):
        assert name in text


def test_a_folder_in_a_format_of_files_is_refused(tmp_path):
    for name in [name for name, form in FORMATS.items() if not form.together]:
        with pytest.raises(
            InputError, match=r"it is a folder, and .* is a file; name the files"
        ):
            find_kind(tmp_path, InputOptions(format=name))
