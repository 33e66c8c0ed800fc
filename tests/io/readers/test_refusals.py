"""What is wrong with a file of a detector or a tracker is said with its place and a fix."""

import json

import numpy as np
import pytest

from shapefit.errors import InputError

from .conftest import read_images as read

PERSON = "pose_keypoints_2d"
POSES = [[1.0, 2.0]] * 17
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


def alphapose(second):
    return {"0.jpg": {"people": []}, "1.jpg": second}


REFUSED = [
    # OpenPose
    ("0.json", '{"people": [{"pose_keypoints_2d": [1, 2', "0.json:1: is not whole JSON"),
    ("0.json", {"people": [3]}, "0.json: is not as its format says"),
    ("0.json", {"people": [{PERSON: 3}]}, "keypoints that are no list; check what wrote"),
    ("0.json", {"people": [{PERSON: [1, 2]}]}, "a person of 2 numbers, not 3"),
    ("0.json", {"people": [{PERSON: [1, "a", 2]}]}, "string to float: 'a'.*; check what"),
    ("0.json", {"people": [{PERSON: [1, [2], 2]}]}, "0.json: is not as its format says"),
    ("0.json", {"shapes": [], "imagePath": ""}, "is JSON of no known kind, an object"),
    ("0.json", {"people_in": 3}, "an object with people_in; give what OpenPose"),
    ("0.json", [1, 2, 3], "a list of objects without names"),
    # AlphaPose
    ("a.json", alphapose({"faces": []}), "1.jpg: no list of people"),
    ("a.json", alphapose(3), "1.jpg: no list of people"),
    ("a.json", alphapose({"people": [3]}), "1.jpg: is not as its format says"),
    ("a.json", alphapose({"people": [{PERSON: [1, 2]}]}), "a person of 2 numbers"),
    # COCO
    ("a.json", annotated(1, 2, 2), "3 numbers for 2 landmarks"),
    ("a.json", annotated(1, 2, 2, category=7), r"annotations\[0\]: there is no 7; give x"),
    ("a.json", annotated(1, 2, 2, image=[0]), r"annotations\[0\]: no image \(\[0\]\)"),
    ("a.json", {"images": 3}, "a.json: is not as its format says .*give a file of COCO"),
    ("a.json", annotated(categories=[{"keypoints": 3, "id": 1}]), r"categories\[0\]: is not as"),
    (
        "a.json",
        annotated(categories=[{**MOUSE, "keypoints": ["a", "a"]}]),
        r"categories\[0\]: the landmark 'a' is there twice",
    ),
    ("r.json", [result(1, 1, 2, 3), 4], r"r.json:\[1\]: is not as its format .* of keypoints$"),
    ("r.json", [result([1], 1, 2, 3)], r"r.json:\[0\]: no image"),
    ("r.json", [result(1, 1, 2)], r"r.json:\[0\]: a person of 2 numbers"),
    ("r.json", [result(1, *range(1, 4)), result(1, *range(1, 7))], "several skeletons: 1 det"),
    # MMPose
    ("v.json", [{"frame_id": 0, "instances": 3}], r"v.json:\[0\]: no list of people"),
    ("v.json", [{"instances": [{}]}], r"v.json:\[0\]: a person without keypoints"),
    (
        "v.json",
        [{"instances": [{"keypoints": [[1, 2, 3]]}]}],
        r"\[0\]: is not as its format",
    ),
    (
        "v.json",
        [{"instances": [{"keypoints": [[1, 2]], "keypoint_scores": []}]}],
        r"\[0\]: is not as its format",
    ),
    ("v.json", {"meta_info": {}}, "v.json: there is no 'instance_info'; give an MMPose"),
    # caliscope
    ("xy.csv", CALISCOPE + "0,0,0,0,0,1\n", "xy.csv:2: has 6 cells"),
    ("xy.csv", CALISCOPE + "0,0,0,0,0,a,1\n", "xy.csv:2: 'a' is no number"),
    ("xy.csv", CALISCOPE + "0,0,0,0,nose,1,1\n", "xy.csv: 'nose' is no whole number"),
    ("xy.csv", CALISCOPE + "0,0,,0,0,1,1\n", "xy.csv: '' is no whole number"),
    # YOLO, with what data.yaml says
    ("a.txt", ("0 .5 .5 .1 .1 .2 .5 .3 .3 .1 .3", None), "no data.yaml with kpt_shape"),
    ("a.txt", (YOLO, "kpt_shape: [2, 3]"), "a line of 8 numbers, and 2 landmarks"),
    ("a.txt", (YOLO + "\n0 .5 x", None), "a.txt:2: 'x' is no number"),
    ("a.txt", (YOLO, "kpt_shape: [2, 9]"), r"kpt_shape is \[2, 9\]; .*data.yaml"),
    ("a.txt", (YOLO, "{"), "data.yaml: is no YAML"),
    (
        "a.txt",
        ("0 .5 .5 .1 .1 2.5 .5 2 .3 .3 2", "kpt_shape: [2, 3]"),
        "the header is .0 .5 .5 .1 .1 2.5",
    ),
    # DeepLabCut
    ("t.csv", DLC + "0,1,2,3,4\n0,1,2,3,4\n", "t/0 occurs more than once"),
    ("t.csv", DLC + "0,1,2,3,4\n1,1,2,3\n", ":5: has 4 cells, not 5"),
    ("t.csv", DLC + "0,1,2,3,4\n1,1,2,three,4\n", r":5: 'three' is no number \(column b/x\)"),
    ("t.csv", DLC + "0,1,2,3,4\none,1,2,3,4\n", ":5: 'one' is no number"),
    ("t.csv", DLC + "0,1,2,3,4\n,1,2,3,4\n", ":5: does not say its frame"),
    ("t.csv", DLC + '0,1,2,3,"4\n', r":4: has a bad cell \(unexpected end"),
    ("t.csv", DLC.replace("b,b", "a,a") + "0,1,2,3,4\n", "has a column twice"),
    ("t.csv", DLC.replace("x,y\n", "x,w\n") + "0,1,2,3,4\n", "has no column b y"),
    (
        "t.csv",
        "scorer,n,n,n,n,n\nbodyparts,a,a,a,b,b\ncoords,x,y,likelihood,x,y\n0,1,2,1,3,4\n",
        "has no column b likelihood",
    ),
    ("t.csv", DLC.replace("x,y,x,y", "l,angle,l,angle"), r"no columns x and y \(l, angle\)"),
    ("t.csv", DLC.replace("coords", "scorer"), "there is no 'coords'"),
    ("t.csv", "scorer,n\n", "there is no 'bodyparts'"),
    ("t.csv", "scorer,n\nbodyparts,\ncoords,\n", "has no columns of coordinates"),
    ("t.csv", DLC.replace(",a,a", ",a"), "the lines of names have 4 and 5 cells"),
    # tables of no known tool: the error shows what was understood
    (
        "t.csv",
        "frame;joint;x;y\n0;a;1;2\n0;b;3;oops\n",
        r"csv:3: 'oops' is no number \(column y\)",
    ),
    ("t.csv", "frame,joint,x,y\n0,a,1,2\n0,a,3,4\n", "csv:3: 'a' of 0 is also in line 2"),
    ("t.csv", "frame,joint,x,y\nlast,a,1,2\n", "'last' is no whole number.*call the column `item`"),
    ("t.csv", "frame,joint,x,y,score\n0,a,1,2,-1\n", "has a confidence of -1"),
    ("t.csv", WIDE + "1,2,3\n", "csv:4: has 3 cells, not 5"),
    (
        "t.csv",
        WIDE + "1,\0,3,4,5\n",
        r"csv:4: is not text \(a zero byte\); save it as CSV in UTF-8",
    ),
    # arrays
    ("a.npy", np.zeros((3, 4)), r"an array of float64 and the shape \(1, 3, 4\)"),
    ("a.npy", np.ones((3, 4, 3)) * 7, "third numbers run from 7 to 7, so are they"),
    ("a.npy", np.ones((3, 4, 3)) * 1.5, r"third numbers run from 1.5 to 1.5, so are they"),
    ("a.npy", np.array([{"a": 1}], dtype=object), "without objects"),
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
    keypoints = {} if name.endswith((".csv", ".txt", ".npy")) else {"keypoints": "numbered"}
    with pytest.raises(InputError, match=message):
        read(path, **keypoints)
