"""What is wrong with a file of a detector or a tracker is said with its place and a
fix.
"""

import json

import numpy as np
import pytest

from shapefit.errors import InputError
from tests.io.files import load_shapes

from .made import read_images as read
from .test_anipose import ANIPOSE
from .test_bvh import BVH, FRAMES, TREE
from .test_trc import HEAD, ROWS
from .test_vicon import TRAJECTORIES

PERSON = "pose_keypoints_2d"
MOUSE = {"id": 1, "name": "mouse", "keypoints": ["nose", "tail"], "skeleton": [[1, 2]]}
DLC = "scorer,n,n,n,n\nbodyparts,a,a,b,b\ncoords,x,y,x,y\n"
CALISCOPE = "sync_index,port,frame_index,frame_time,point_id,img_loc_x,img_loc_y\n"
WIDE = "frame,nose_x,nose_y,tail_x,tail_y\n7,1,2,30,40\n8,5,6,70,80\n"
YOLO = "0 .5 .5 .1 .1 .2 .5 2"


RAT = {"id": 2, "name": "rat", "keypoints": ["nose", "paw"]}


def annotated(*keypoints, image=0, category=1, **further):
    """Return a COCO file of one annotation with these keypoints."""
    annotation = {
        "id": 0,
        "image_id": image,
        "category_id": category,
        "keypoints": list(keypoints),
    }
    file = {
        "images": [{"id": 0, "file_name": "day/0.png"}],
        "categories": [MOUSE],
        "annotations": [annotation],
    }
    return file | further


def result(image, *keypoints):
    return {"image_id": image, "category_id": 1, "keypoints": list(keypoints)}


REFUSED = [
    # OpenPose
    (
        "0.json",
        '{"people": [{"pose_keypoints_2d": [1, 2',
        "0.json:1: is not whole JSON",
    ),
    ("0.json", {"people": [3]}, r"0.json: .*no known kind, with people \(a set of Op"),
    (
        "0.json",
        {"people": [{PERSON: [1, 2, 1]}, 3]},
        r"0.json: cannot be read as a file of people \(\[1\] is 3, not an object\)",
    ),
    ("0.json", {"people": [{PERSON: 3}]}, "a person without a list of keypoints"),
    ("0.json", {"people": [{PERSON: [1, 2]}]}, "a person of 2 numbers, not 3"),
    (
        "0.json",
        {"people": [{PERSON: [1, "a", 2]}]},
        r"keypoints of a person are not all numbers.*; remove it from the folder",
    ),
    # COCO
    (
        "a.json",
        annotated(1, 2, 2),
        "annotation 0 has 1 landmark, and category mouse names 2.; correct the",
    ),
    (
        "a.json",
        annotated(1, 2, 2, category=7, categories=[MOUSE, {**MOUSE, **RAT}]),
        "annotation 0 is of category 7, which is not among the categories",
    ),
    (
        "a.json",
        annotated(1, 2, 2, image=[0]),
        r"annotations\[0\].image_id is a list, not a whole number or a text",
    ),
    (
        "a.json",
        annotated(*[[1, 2]] * 2),
        "keypoints of annotation 0 are pairs, not x, y",
    ),
    ("a.json", annotated(1, 2, 2, 3), "annotation 0 are 4 numbers, not 3 a landmark"),
    ("a.json", annotated(1, 2, {}, 3), "keypoints of annotation 0 are not all numbers"),
    ("a.json", {"images": 3}, "no known kind, with images .a file of COCO annotations"),
    ("a.json", {"images": 3, "annotations": []}, "images is 3, not a list"),
    ("a.json", {"images": [], "annotations": [{}]}, "no 'image_id' in annotations.0."),
    (
        "a.json",
        annotated(categories=[{**MOUSE, "keypoints": ["a", "a"]}]),
        "landmark 'a' twice",
    ),
    (
        "r.json",
        [result(1, 1, 2, 3), 4],
        r"r.json: cannot be read as a file of COCO results \(\[1\] is 4, not an object",
    ),
    ("r.json", [result(1, 1, 2)], "a person of 2 numbers"),
    (
        "r.json",
        [result(1, *range(1, 4)), result(1, *range(1, 7))],
        "several skeletons: 1 det",
    ),
    # MMPose
    ("v.json", [{"frame_id": 0, "instances": 3}], r"\[0\].instances is 3, not a list"),
    (
        "v.json",
        [{"frame_id": n % 2, "instances": []} for n in range(3)],
        "v.json: .*frame 0 twice",
    ),
    ("v.json", [{"instances": [{}]}], "v.json: .*a person without a list"),
    (
        "v.json",
        [{"instances": [{"keypoints": [[1, 2, 3]]}]}],
        r"keypoints are \[x, y, z\], so points in 3D\); give landmarks in 2D",
    ),
    (
        "v.json",
        [{"instances": [{"keypoints": [[1, 2]], "keypoint_scores": []}]}],
        "1 landmarks of a person, and 0 confidences",
    ),
    ("v.json", {"meta_info": {}}, "no known kind, with meta_info .an MMPose file has"),
    (
        "v.json",
        {"meta_info": {"keypoint_id2name": {"1": "a"}}, "instance_info": []},
        "keypoint_id2name does not number the landmarks from 0 on",
    ),
    # caliscope
    ("xy.csv", CALISCOPE + "0,0,0,0,0,1\n", "xy.csv:2: has 6 cells"),
    ("xy.csv", CALISCOPE + "0,0,0,0,0,a,1\n", "xy.csv:2: 'a' is no number"),
    (
        "xy.csv",
        CALISCOPE + "0,0,0,0,nose,1,1\n",
        "xy.csv: .*'nose'. is no whole number",
    ),
    # YOLO, with what data.yaml says
    ("a.txt", ("0 .5 .5 .1 .1 .2 .5 .3 .3 .1 .3", None), "no data.yaml beside them"),
    ("a.txt", (YOLO, "kpt_shape: [2, 3]"), "a line of 8 numbers, and 2 landmarks"),
    ("a.txt", (YOLO + "\n0 .5 x", None), "a.txt:2: .*'x' is no number"),
    (
        "a.txt",
        (YOLO, "kpt_shape: [2, 9]"),
        "2 landmarks take 23.; check kpt_shape in data.yaml",
    ),
    ("a.txt", (YOLO, "{"), "data.yaml: cannot be read as YAML"),
    (
        "a.txt",
        ("0 .5 .5 .1 .1 2.5 .5 2 .3 .3 2", "kpt_shape: [2, 3]"),
        "the header is .0 .5 .5 .1 .1 2.5",
    ),
    # DeepLabCut
    ("t.csv", DLC + "0,1,2,3,4\n0,1,2,3,4\n", "item 't/0' is also at"),
    ("t.csv", DLC + "0,1,2,3,4\n1,1,2,3\n", ":5: has 4 cells, not 5"),
    (
        "t.csv",
        DLC + "0,1,2,3,4\n1,1,2,three,4\n",
        r":5: 'three' is no number \(column b/x\)",
    ),
    ("t.csv", DLC + "0,1,2,3,4\none,1,2,3,4\n", ":5: 'one' is no number"),
    ("t.csv", DLC + "0,1,2,3,4\n,1,2,3,4\n", "t.csv: .*a frame without a number"),
    ("t.csv", DLC.replace("b,b", "a,a") + "0,1,2,3,4\n", "a column twice"),
    ("t.csv", DLC.replace("x,y\n", "x,w\n") + "0,1,2,3,4\n", "no column .'b y'"),
    (
        "t.csv",
        DLC.replace("x,y,x,y", "l,angle,l,angle"),
        r"no columns x and y \(l, angle\)",
    ),
    ("t.csv", DLC.replace("coords", "scorer"), "there is no line coords"),
    ("t.csv", "scorer,n\nbodyparts,\ncoords,\n", "no columns of coordinates"),
    (
        "t.csv",
        DLC.replace(",a,a", ",a"),
        "lines of names have different numbers of cells",
    ),
    # tables of no known tool
    (
        "t.csv",
        "frame;joint;x;y\n0;a;1;2\n0;b;3;oops\n",
        r"csv:3: 'oops' is no number \(column y\)",
    ),
    (
        "t.csv",
        "frame;a_x;a_y;b_x;b_y\n0;1,234;2;3;4\n1;5.5;6;7;8\n",
        "csv:2: '1,234' is no numb",
    ),
    ("t.csv", "joint,x\na,1\nb,3\n", "t.csv:1: the header is 'joint,x'"),
    (
        "t.csv",
        "joint,x,y\na,1,2\na,3,4\n",
        "t.csv:3: 'a' is also in line 2; tell the images apart by a column `item`",
    ),
    (
        "t.csv",
        "frame,joint,x,y\n0,a,1,2\n0,a,3,4\n",
        "csv:3: 'a' of 0 is also in line 2",
    ),
    (
        "t.csv",
        "frame,joint,x,y\nlast,a,1,2\n",
        "'last'. is no whole number.*call the column `it",
    ),
    ("t.csv", "frame,joint,x,y\ninf,a,1,2\n", "'inf'. is no whole number"),
    ("t.csv", "frame,joint,x,y,score\n0,a,1,2,-1\n", "a confidence below 0"),
    ("t.csv", WIDE + "1,2,3\n", "csv:4: has 3 cells, not 5"),
    (
        "t.csv",
        WIDE + "1,\0,3,4,5\n",
        r"csv:4: is not text \(a zero byte\); save it as CSV in UTF",
    ),
    # arrays
    ("a.npy", np.zeros((3, 4)), r"float64 of the shape \(1, 3, 4\)"),
    ("a.npy", np.ones((3, 4, 3)) * 7, "third numbers run from 7 to 7, are they"),
    ("a.npy", np.array([{"a": 1}], dtype=object), "without objects"),
    # motion
    ("walk.trc", HEAD + ROWS.replace("8", "x"), "walk.trc:7: 'x' is no number"),
    (
        "walk.trc",
        HEAD + ROWS.replace("6\n", "6\t7\n", 1),
        "walk.trc:6: has 9 cells, not 8",
    ),
    ("walk.trc", HEAD + ROWS.replace("\t", "  "), "walk.trc:6: has 1 cells, not 8"),
    ("walk.trc", HEAD.partition("Frame#")[0], "walk.trc: cannot be read as a TRC file"),
    (
        "walk.trc",
        HEAD.replace("e\t\t\ta", "e\ta"),
        "names that do not stand above an X",
    ),
    (
        "fly.csv",
        ANIPOSE.replace("0.8,1,0,7", "0.8,1,7"),
        "fly.csv:2: has 14 cells, not 15",
    ),
    ("fly.csv", ANIPOSE.replace("1.5,", "one,"), "fly.csv:3: 'one'"),
    (
        "w.bvh",
        TREE + FRAMES.replace("90 90 0", "90 90"),
        "w.bvh:20: has 8 cells, not 9",
    ),
    ("w.bvh", TREE + FRAMES.replace("90 90 0", "90 inf 0"), "w.bvh:20: 'inf'"),
    ("w.bvh", TREE.partition("MOTION")[0], "w.bvh: has no motion"),
    ("w.bvh", BVH.replace("  }\n}\n", ""), "w.bvh:16: .*not complete"),
    ("w.bvh", BVH.replace("CHANNELS 3", "CHANNELS 4"), "w.bvh:9: .*4 channels"),
    ("w.bvh", BVH.replace("Zrotation", "Wrotation"), "w.bvh:5: .*'Wrotation'"),
    ("w.bvh", BVH.replace("OFFSET 0 -4 0", "x OFFSET 0 -4 0"), "w.bvh:8: .*'x'"),
    ("w.bvh", BVH.replace("0 -4 0", "0 -4 nan"), "w.bvh:8: .*'nan' is no number"),
    ("w.bvh", BVH.replace("Time: 0.04", "Time: soon"), "w.bvh:18: .*soon"),
    # Vicon
    (
        "v.csv",
        TRAJECTORIES.replace("1001", "left"),
        r"v\.csv:7: 'left' is no number \(column Anna:LASI X",
    ),
    (
        "v.csv",
        TRAJECTORIES.replace("X,Y,Z,X", "X,Y,Z,Y"),
        "other columns than X, Y and Z",
    ),
    (
        "v.csv",
        TRAJECTORIES.replace("100,,", "fast,,", 1),
        "v.csv: .*'fast' is no number",
    ),
    (
        "v.csv",
        TRAJECTORIES.replace("7,0,1000", "7,0,1000,5,5,5"),
        r"v\.csv:6: has 11 cells, not 8",
    ),
]


MOTION_FILES = ("walk.trc", "fly.csv", "w.bvh", "v.csv")
"""Files of shapes; all others are landmarks."""


def write_content(path, content):
    """Write an array, a text, a value as JSON, or a text and its data.yaml."""
    if isinstance(content, np.ndarray):
        np.save(path, content, allow_pickle=True)
        return
    if isinstance(content, tuple):
        content, data_yaml = content
        if data_yaml is not None:
            (path.parents[1] / "data.yaml").write_text(data_yaml)
    text = content if isinstance(content, str) else json.dumps(content)
    path.write_text(text, encoding="utf-8")


@pytest.mark.parametrize(("name", "content", "message"), REFUSED)
def test_what_is_wrong_is_named(tmp_path, name, content, message):
    path = tmp_path / "set" / name
    path.parent.mkdir()
    write_content(path, content)
    keypoints = {"keypoints": "numbered"} if path.suffix == ".json" else {}
    read_file = load_shapes if name in MOTION_FILES else read
    with pytest.raises(InputError, match=message):
        read_file(path, **keypoints)
