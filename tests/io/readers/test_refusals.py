"""What is wrong with a file of a detector or a tracker is said with its place and a fix."""

import gzip
import json
import pickle

import numpy as np
import pytest

from shapefit.errors import InputError
from shapefit.io import inputs, open_landmarks
from shapefit.io.detect import FORMATS, detect_format
from shapefit.io.options import InputOptions
from shapefit.io.source import find_kind
from tests.io.files import load_shapes

from .made import read_images as read
from .test_motion import ANIPOSE, BVH, FLY, FRAMES, HEAD, ROWS, TREE, VICON

PERSON = "pose_keypoints_2d"
MOUSE = {"id": 1, "name": "mouse", "keypoints": ["nose", "tail"], "skeleton": [[1, 2]]}
DLC = "scorer,n,n,n,n\nbodyparts,a,a,b,b\ncoords,x,y,x,y\n"
CALISCOPE = "sync_index,port,frame_index,frame_time,point_id,img_loc_x,img_loc_y\n"
WIDE = "frame,nose_x,nose_y,tail_x,tail_y\n7,1,2,30,40\n8,5,6,70,80\n"
YOLO = "0 .5 .5 .1 .1 .2 .5 2"


def annotated(*keypoints, image=0, category=1, **further):
    entry = {"id": 0, "image_id": image, "category_id": category, "keypoints": list(keypoints)}
    images = [{"id": 0, "file_name": "day/0.png"}]
    return {"images": images, "categories": [MOUSE], "annotations": [entry], **further}


def result(image, *keypoints):
    return {"image_id": image, "category_id": 1, "keypoints": list(keypoints)}


REFUSED = [
    # OpenPose
    ("0.json", '{"people": [{"pose_keypoints_2d": [1, 2', "0.json:1: is not whole JSON"),
    ("0.json", {"people": [3]}, "0.json: cannot be read as a file of people"),
    ("0.json", {"people": [{PERSON: 3}]}, "a person without a list of keypoints"),
    ("0.json", {"people": [{PERSON: [1, 2]}]}, "a person of 2 numbers, not 3"),
    ("0.json", {"people": [{PERSON: [1, "a", 2]}]}, "string to float: 'a'.*; export it again"),
    # COCO
    ("a.json", annotated(1, 2, 2), "cannot reshape array of size 3"),
    ("a.json", annotated(1, 2, 2, category=7), "a.json: cannot be read as .* has no 7"),
    ("a.json", annotated(1, 2, 2, image=[0]), "a.json: cannot be read .*unhashable"),
    ("a.json", {"images": 3}, "a.json: cannot be read as a file of COCO annotations"),
    ("a.json", annotated(categories=[{**MOUSE, "keypoints": ["a", "a"]}]), "landmark 'a' twice"),
    ("r.json", [result(1, 1, 2, 3), 4], "r.json: cannot be read as a file of COCO results"),
    ("r.json", [result(1, 1, 2)], "a person of 2 numbers"),
    ("r.json", [result(1, *range(1, 4)), result(1, *range(1, 7))], "several skeletons: 1 det"),
    # MMPose
    ("v.json", [{"frame_id": 0, "instances": 3}], "v.json: .*no list of people"),
    ("v.json", [{"instances": [{}]}], "v.json: .*a person without a list"),
    ("v.json", [{"instances": [{"keypoints": [[1, 2, 3]]}]}], "v.json: cannot be read as an MMP"),
    (
        "v.json",
        [{"instances": [{"keypoints": [[1, 2]], "keypoint_scores": []}]}],
        "v.json: cannot be read as an MMPose",
    ),
    ("v.json", {"meta_info": {}}, "v.json: .*it has no 'instance_info'"),
    # caliscope
    ("xy.csv", CALISCOPE + "0,0,0,0,0,1\n", "xy.csv:2: has 6 cells"),
    ("xy.csv", CALISCOPE + "0,0,0,0,0,a,1\n", "xy.csv:2: 'a' is no number"),
    ("xy.csv", CALISCOPE + "0,0,0,0,nose,1,1\n", "xy.csv: .*'nose'. is no whole number"),
    # YOLO, with what data.yaml says
    ("a.txt", ("0 .5 .5 .1 .1 .2 .5 .3 .3 .1 .3", None), "no data.yaml beside them"),
    ("a.txt", (YOLO, "kpt_shape: [2, 3]"), "a line of 8 numbers, and 2 landmarks"),
    ("a.txt", (YOLO + "\n0 .5 x", None), "a.txt:2: .*'x' is no number"),
    ("a.txt", (YOLO, "kpt_shape: [2, 9]"), "2 landmarks take 23.; check kpt_shape in data.yaml"),
    ("a.txt", (YOLO, "{"), "data.yaml: cannot be read as YAML"),
    (
        "a.txt",
        ("0 .5 .5 .1 .1 2.5 .5 2 .3 .3 2", "kpt_shape: [2, 3]"),
        "the header is .0 .5 .5 .1 .1 2.5",
    ),
    # DeepLabCut
    ("t.csv", DLC + "0,1,2,3,4\n0,1,2,3,4\n", "item 't/0' is also at"),
    ("t.csv", DLC + "0,1,2,3,4\n1,1,2,3\n", ":5: has 4 cells, not 5"),
    ("t.csv", DLC + "0,1,2,3,4\n1,1,2,three,4\n", r":5: 'three' is no number \(column b/x\)"),
    ("t.csv", DLC + "0,1,2,3,4\none,1,2,3,4\n", ":5: 'one' is no number"),
    ("t.csv", DLC + "0,1,2,3,4\n,1,2,3,4\n", "t.csv: .*a frame without a number"),
    ("t.csv", DLC.replace("b,b", "a,a") + "0,1,2,3,4\n", "a column twice"),
    ("t.csv", DLC.replace("x,y\n", "x,w\n") + "0,1,2,3,4\n", "no column .'b y'"),
    ("t.csv", DLC.replace("x,y,x,y", "l,angle,l,angle"), r"no columns x and y \(l, angle\)"),
    ("t.csv", DLC.replace("coords", "scorer"), "it has no 'coords'"),
    ("t.csv", "scorer,n\nbodyparts,\ncoords,\n", "no columns of coordinates"),
    ("t.csv", DLC.replace(",a,a", ",a"), "lines of names have different numbers of cells"),
    # tables of no known tool
    (
        "t.csv",
        "frame;joint;x;y\n0;a;1;2\n0;b;3;oops\n",
        r"csv:3: 'oops' is no number \(column y\)",
    ),
    ("t.csv", "frame;a_x;a_y;b_x;b_y\n0;1,234;2;3;4\n1;5.5;6;7;8\n", "csv:2: '1,234' is no numb"),
    ("t.csv", "frame,joint,x,y\n0,a,1,2\n0,a,3,4\n", "csv:3: 'a' of 0 is also in line 2"),
    ("t.csv", "frame,joint,x,y\nlast,a,1,2\n", "'last'. is no whole number.*call the column `it"),
    ("t.csv", "frame,joint,x,y,score\n0,a,1,2,-1\n", "a confidence below 0"),
    ("t.csv", WIDE + "1,2,3\n", "csv:4: has 3 cells, not 5"),
    ("t.csv", WIDE + "1,\0,3,4,5\n", r"csv:4: is not text \(a zero byte\); save it as CSV in UTF"),
    # arrays
    ("a.npy", np.zeros((3, 4)), r"float64 of the shape \(1, 3, 4\)"),
    ("a.npy", np.ones((3, 4, 3)) * 7, "third numbers run from 7 to 7, are they"),
    ("a.npy", np.array([{"a": 1}], dtype=object), "without objects"),
    # motion
    ("walk.trc", HEAD + ROWS.replace("8", "x"), "walk.trc:7: 'x' is no number"),
    ("walk.trc", HEAD + ROWS.replace("6\n", "6\t7\n", 1), "walk.trc:6: has 9 cells, not 8"),
    ("walk.trc", HEAD + ROWS.replace("\t", "  "), "walk.trc:6: has 1 cells, not 8"),
    ("walk.trc", HEAD.partition("Frame#")[0], "walk.trc: cannot be read as a TRC file"),
    ("walk.trc", HEAD.replace("e\t\t\ta", "e\ta"), "names that do not stand above an X"),
    ("fly.csv", ANIPOSE + FLY.replace("0.8,1,0,7", "0.8,1,7"), "fly.csv:2: has 14 cells, not 15"),
    ("fly.csv", ANIPOSE + FLY.replace("1.5,", "one,"), "fly.csv:3: 'one'"),
    ("w.bvh", TREE + FRAMES.replace("90 90 0", "90 90"), "w.bvh:20: has 8 cells, not 9"),
    ("w.bvh", TREE + FRAMES.replace("90 90 0", "90 inf 0"), "w.bvh:20: 'inf'"),
    ("w.bvh", TREE.partition("MOTION")[0], "w.bvh: has no motion"),
    ("w.bvh", BVH.replace("  }\n}\n", ""), "w.bvh:16: .*not complete"),
    ("w.bvh", BVH.replace("CHANNELS 3", "CHANNELS 4"), "w.bvh:9: .*4 channels"),
    ("w.bvh", BVH.replace("Zrotation", "Wrotation"), "w.bvh:5: .*'Wrotation'"),
    ("w.bvh", BVH.replace("OFFSET 0 -4 0", "x OFFSET 0 -4 0"), "w.bvh:8: .*'x'"),
    ("w.bvh", BVH.replace("0 -4 0", "0 -4 nan"), "w.bvh:8: .*'nan' is no number"),
    ("w.bvh", BVH.replace("Time: 0.04", "Time: soon"), "w.bvh:18: .*soon"),
    # Vicon
    ("v.csv", VICON.replace("1001", "left"), r"v\.csv:7: 'left' is no number \(column Anna:LASI X"),
    ("v.csv", VICON.replace("X,Y,Z,X", "X,Y,Z,Y"), "other columns than X, Y and Z"),
    ("v.csv", VICON.replace("100,,", "fast,,", 1), "v.csv: .*'fast' is no number"),
    ("v.csv", VICON.replace("7,0,1000", "7,0,1000,5,5,5"), r"v\.csv:6: has 11 cells, not 8"),
]


@pytest.mark.parametrize(("name", "content", "message"), REFUSED)
def test_what_is_wrong_is_named(tmp_path, name, content, message):
    path = tmp_path / "set" / name
    path.parent.mkdir()
    if isinstance(content, np.ndarray):
        np.save(path, content, allow_pickle=True)
    else:
        if isinstance(content, tuple):
            content, said = content
            (tmp_path / "data.yaml").write_text(said) if said else None
        text = content if isinstance(content, str) else json.dumps(content)
        path.write_text(text, encoding="utf-8")
    shapes = name in ("walk.trc", "fly.csv", "w.bvh", "v.csv")
    keypoints = {} if name.endswith((".csv", ".txt", ".npy")) else {"keypoints": "numbered"}
    with pytest.raises(InputError, match=message):
        load_shapes(path) if shapes else read(path, **keypoints)


# Files that are no recordings: each is named for what it is, in one line.

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
    assert "neither text nor of a known format; give the landmarks that a" in refusal(path)


TIDY = b"item,landmark,x,y\ni,a,250,5\ni,b,75,125\n"
TRACKS = b"frame,track_id,nose_x,nose_y,hip_x,hip_y\n0,1,10,20,30,50\n0,2,11,21,31,51\n"
ARRAY = b"[[[1,2],[3,4]]]"


@pytest.mark.parametrize(
    ("name", "content"),
    [("t.csv", TIDY), ("w.csv", TRACKS), ("d.csv", TEXT), ("a.json", ARRAY), ("bare", TIDY)],
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
    "content",
    ["[cam_0]\nmatrix = [[1.0]]\n", "%YAML:1.0\n---\ncamera_matrix: !!opencv-matrix\n",
     '{"cam_0": {"matrix": [[1, 0], [0, 1]], "size": [3, 4]}}'],
)  # fmt: skip
def test_a_calibration_is_no_file_of_landmarks(tmp_path, content):
    (tmp_path / "cameras").write_text(content)
    assert "is a calibration of cameras, not landmarks; give" in refusal(tmp_path / "cameras")


@pytest.mark.parametrize(
    ("line", "found"),
    [
        ("scorer;a;a;a", "the header is 'scorer;a;a;a'; write the header"),
        ("track,frame_idx,instance.score,nose.x,nose.y,nose.score", "the header is 'track,frame_"),
    ],
)
def test_tables_of_another_kind(tmp_path, line, found):
    path = tmp_path / "walk.csv"
    path.write_text(f"{line}\n")
    assert found in refusal(path)


def test_a_folder_in_a_format_of_files_is_refused(tmp_path):
    for name in [name for name, form in FORMATS.items() if not form.together]:
        with pytest.raises(InputError, match=r"it is a folder, and .* is a file; name the files"):
            find_kind(tmp_path, InputOptions(format=name))
