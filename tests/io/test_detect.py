"""JSON of detectors is recognised by the keys of the whole file, whatever comes first in it."""

import json

import numpy as np
import pytest

from shapefit.errors import InputError
from shapefit.io.detect import FORMATS, detect_format

LONG = np.arange(3 * 2000.0).tolist()
PAIRS = np.arange(2 * 2000.0).reshape(-1, 2).tolist()
POINT = {"x": 0.5, "y": 0.25, "z": 0.0}


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("openpose", {"people": [{"pose_keypoints_2d": LONG}], "version": 1.3}),
        ("openpose", {"version": 1.3}),
        ("coco-annotations", {"info": {"version": "1.0"}, "annotations": [], "images": []}),
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
        ('{"entries": [{"a": {"at": 0, "x": 1, "y": 2}}]}', "of no known kind, with entries"),
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
    [("", "csv"), (",confidence,sequence", "csv"), (",person_id", "table"), (",id", "table")],
)
def test_a_table_with_a_column_of_individuals_is_none_of_ours(tmp_path, further, name):
    path = tmp_path / "landmarks.csv"
    path.write_text(f"item,landmark,x,y{further}\n")
    assert detect_format(path) is FORMATS[name]
